"""How the cost grows with the team: ticks a second, processor time per arm, and a model that is held against both."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil

import numpy as np

from deploy.bench.carry import Carry, carry
from deploy.bench.figures import RATIO, Part, Samples
from deploy.bench.plan import Plan, arms_text, team_of

OWN_PARTS = ("send", "step")
"""Of a tick: what the simulator does while all others wait for it."""

OWN = "the simulator's own parts"
SIMULATOR, FOLLOWER, LEADER, ALL = (f"processor time: {who}" for who in ("simulator", "a follower", "leader", "all"))


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one tick, us."""

    arms: int
    tick: float
    """Wall time, mean."""
    own: float
    """Of that, the simulator's own parts, median: nobody else works meanwhile."""
    simulator: float
    """Processor time of the simulator's process, all threads."""
    follower: float
    """Of one follower's, mean of the team."""
    leader: float


def cost_of(found: Carry, arms: int) -> Cost | None:
    """None where the system does not tell processor times."""
    cpu = found.cpu_us
    followers = [used for name, used in cpu.items() if name not in ("sim", "leader")]
    if not followers or "sim" not in cpu:
        return None
    own = sum(found.measured["tick_parts_us"][part]["p50"] for part in OWN_PARTS)
    return Cost(arms, 1e6 / found.ticks_per_s, own, cpu["sim"], statistics.fmean(followers), cpu.get("leader", 0.0))


def tick_us(cost: Cost, cores: int, waking_us: float = 0.0) -> float:
    """The model, us: the simulator's own parts one after the other, and all other work shared by the cores.

    ``T = w + P + (U - P + N F + L) / K``: P the simulator's own parts, U all its processor time, F a follower's, L the
    leader's, N arms, K cores; w the time in which nobody works, since processes wake up one after the other.
    """
    rest = max(0.0, cost.simulator - cost.own) + cost.arms * cost.follower + cost.leader
    return waking_us + cost.own + rest / cores


def tick_us_apart(cost: Cost, cores: int, machines: int, waiting_us: float) -> float:
    """The model with the simulator on a machine of its own and the followers on others, us.

    ``T = w + U + ceil(N / (M K)) F``: M machines of K cores for the followers, and w all waiting, the network's round
    trip included.
    """
    return waiting_us + cost.simulator + ceil(cost.arms / (machines * cores)) * cost.follower


def measure_growth(plan: Plan, tell: Callable[[str], None]) -> Part:
    """Every size of team in every turn."""
    samples = Samples()
    cores = os.cpu_count() or 1
    for k in range(plan.turns):
        found: dict[int, Carry] = {}
        for count in plan.arms:
            tell(f"turn {k + 1} of {plan.turns}, {arms_text(count)}")
            found[count] = carry(team_of(count), plan.seconds)
        _add(samples, found, cores)
    return Part(
        "growth",
        "Growth with the number of arms",
        samples.figures(),
        (
            f"The line: time of a tick = a + b times arms. The model: the simulator's own parts (read and send, step), "
            f"all other processor time shared by {cores} cores, and the time in which nobody works, from the smallest "
            "team: docs/scale.md.",
        ),
    )


def _add(samples: Samples, found: Mapping[int, Carry], cores: int) -> None:
    """One turn's figures."""
    ticks_us = {count: 1e6 / each.ticks_per_s for count, each in found.items()}
    costs = {count: cost for count, each in found.items() if (cost := cost_of(each, count)) is not None}
    first = next(iter(found))
    waking_us = costs[first].tick - tick_us(costs[first], cores) if first in costs else 0.0
    for count, each in found.items():
        column = arms_text(count)
        samples.add("ticks/s", column, "ticks/s", each.ticks_per_s, "more")
        samples.add("ticks/s times arms", column, "ticks/s", count * each.ticks_per_s, "more")
        samples.add("one tick", column, "us", ticks_us[count], "less")
        cost = costs.get(count)
        if cost is not None:
            everybody = sum(each.cpu_us.values())
            samples.add(OWN, column, "us", cost.own, "less")
            samples.add(SIMULATOR, column, "us", cost.simulator, "less", positive=False)
            samples.add(FOLLOWER, column, "us", cost.follower, "less", positive=False)
            samples.add(LEADER, column, "us", cost.leader, "less", positive=False)
            samples.add(ALL, column, "us", everybody, "less", positive=False)
            samples.ratio(f"{ALL} / one tick", column, everybody, cost.tick)
            model_us = tick_us(cost, cores, waking_us)
            samples.add("model / measured", column, RATIO, model_us / cost.tick, positive=False)
    samples.add("nobody works", arms_text(first), "us", waking_us, "less", positive=False)
    if len(found) > 1:
        a, b = straight_line(ticks_us)
        samples.add("the line's a", arms_text(first), "us", a, positive=False)
        samples.add("the line's b, per arm", arms_text(first), "us", b, positive=False)
        for count, us in ticks_us.items():
            samples.add("line / measured", arms_text(count), RATIO, (a + b * count) / us, positive=False)


def costs_in(part: Part) -> list[Cost]:
    """The costs that a part ``growth`` tells: medians, one for each size of team."""
    rows = {(figure.row, figure.column): figure.value for figure in part.figures}
    columns = {column: int(column.split()[0]) for row, column in rows if row == OWN}
    return [
        Cost(count, *(rows[row, column] for row in ("one tick", OWN, SIMULATOR, FOLLOWER, LEADER)))
        for column, count in columns.items()
    ]


def straight_line(ticks_us: Mapping[int, float]) -> tuple[float, float]:
    """a and b of ``a + b N``, us, that make the sum of squared relative errors least. For two sizes or more."""
    N, us = np.array(list(ticks_us), float), np.array(list(ticks_us.values()))
    (a, b), *_ = np.linalg.lstsq(np.stack([1 / us, N / us], axis=1), np.ones(len(us)), rcond=None)
    return float(a), float(b)
