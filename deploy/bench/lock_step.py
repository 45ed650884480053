"""Lock-step: ticks a second of the whole system, beside its transport alone, a peer, and the kernel's own sockets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass

from deploy.bench.carry import RECORD_EVERY_MS, carry
from deploy.bench.figures import RATIO, Part, Samples
from deploy.bench.plan import Plan, arms_text, team_of
from deploy.bench.rigs import NO_PEER, TRANSPORTS, Rig, has_peer
from deploy.bench.watching import NO_RECORDER, can_record

Tell = Callable[[str], None]
SYSTEM, RECORDED = "Palanquin", "Palanquin, recorded at 100 Hz"
ZENOH, PEER, FLOOR = TRANSPORTS["zenoh"], TRANSPORTS["zmq"], TRANSPORTS["sockets"]
RECORD_SOME = {"record": {"every_ticks": RECORD_EVERY_MS}}


@dataclass(frozen=True, slots=True)
class Turn:
    """What one turn gave, in ticks a second."""

    system: float
    bare: Mapping[str, float]
    """By transport."""
    recorded: float | None = None


def lock_step_turn(arms: int, rigs: Mapping[str, Rig], plan: Plan, *, recorded: bool) -> Turn:
    """Every bare transport, the system, every bare transport again: what is bare is the mean of before and after."""
    before = {name: rig.ticks_per_s(plan.slice_s) for name, rig in rigs.items()}
    system = carry(team_of(arms), plan.seconds, RECORD_SOME).ticks_per_s
    with_recorder = carry(team_of(arms), plan.seconds, RECORD_SOME, recorded=True).ticks_per_s if recorded else None
    after = {name: rig.ticks_per_s(plan.slice_s) for name, rig in rigs.items()}
    return Turn(system, {name: 0.5 * (before[name] + after[name]) for name in rigs}, with_recorder)


def measure_lock_step(plan: Plan, tell: Tell) -> Part:
    """The whole carry with every size of team, and what stands beside it."""
    samples, said = Samples(), [] if has_peer() else [NO_PEER]
    transports = [name for name in TRANSPORTS if name != "zmq" or has_peer()]
    if not can_record():
        said.append(NO_RECORDER)
    for count in plan.arms:
        names = [f"a{k}" for k in range(1, count + 1)]
        with ExitStack() as stack:
            tell(f"{arms_text(count)}: starting the bare transports")
            rigs = {name: stack.enter_context(Rig(name, names)) for name in transports}
            for k in range(plan.turns):
                tell(f"{arms_text(count)}: turn {k + 1} of {plan.turns}")
                _add(samples, count, lock_step_turn(count, rigs, plan, recorded=count == plan.team and can_record()))
    said.append(
        "Bare: as many processes, a leader among them, our message sizes, agents that answer at once, no physics; "
        "bare Zenoh with our own settings, passwords and rules. Palanquin writes a row of its trace every 10 ms here."
    )
    figures = sorted(samples.figures(), key=lambda figure: (figure.unit == RATIO, not figure.row.startswith(SYSTEM)))
    return Part("lock-step", "Lock-step: ticks a second", tuple(figures), tuple(said))


def _add(samples: Samples, count: int, turn: Turn) -> None:
    """One turn's figures."""
    column, bare = arms_text(count), {TRANSPORTS[name]: value for name, value in turn.bare.items()}
    samples.add(SYSTEM, column, "ticks/s", turn.system, "more")
    if turn.recorded is not None:
        samples.add(RECORDED, column, "ticks/s", turn.recorded, "more")
    for name, value in bare.items():
        samples.add(name, column, "ticks/s", value, "more")
    samples.ratio(f"{SYSTEM} / {ZENOH}", column, turn.system, bare[ZENOH], "more")
    if turn.recorded is not None:
        samples.ratio("recorded / not", column, turn.recorded, turn.system, "more")
    if PEER in bare:
        samples.ratio(f"{ZENOH} / {PEER}", column, bare[ZENOH], bare[PEER], "more")
    samples.ratio(f"{ZENOH} / {FLOOR}", column, bare[ZENOH], bare[FLOOR], "more")
