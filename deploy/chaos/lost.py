"""Robustness: any one follower lost, in any way, at a drawn tick of the carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from deploy.chaos.catalogue import Event, Span
from deploy.chaos.outcome import Judgement, Outcome, outcome_counts
from deploy.chaos.storm import Carry
from deploy.planned_run import Changes, Run, merged
from sim_server.scenario import WhenLost
from sim_server.scenario_events import EVENT_KINDS

LOSSES = tuple(kind for kind in ("kill", "stop", "hang") if kind in EVENT_KINDS)
"""Ways in which a follower is lost."""
TRANSPORT: Changes = {"duration_s": 16.0}
"""Two metres; an undisturbed team arrives after 8 s."""
WINDOW_S = Span(0.0, 8.0)
STREAM = 0x1057


@dataclass(frozen=True, slots=True)
class Loss:
    """One draw."""

    way: str
    when_lost: WhenLost
    arm: str
    tick: int

    @property
    def name(self) -> str:
        """What is done to the follower's process, and what its arm does then."""
        return f"{self.way}, {self.when_lost}"

    @property
    def event(self) -> Event:
        """As a scenario has it; the carry's tick is a millisecond."""
        return {"at_s": self.tick / 1000, "kind": self.way, "agent": self.arm}


def draw_losses(arms: Sequence[str], count: int, seed: int) -> list[Loss]:
    """So many losses; the ways come in turn, so that each is drawn as often as the others."""
    draws = np.random.default_rng([seed, STREAM])
    ways = [(way, when) for way in LOSSES for when in get_args(WhenLost)]
    first, last = round(1000 * WINDOW_S.low), round(1000 * WINDOW_S.high)
    return [
        Loss(*ways[k % len(ways)], str(draws.choice(list(arms))), int(draws.integers(first, last)))
        for k in range(count)
    ]


def run_of(loss: Loss, preset: str, seed: int, scenario: str = "transport") -> Run:
    """The carry in which that happens."""
    changes = merged(TRANSPORT, {"team": {"controller": preset, "when_lost": loss.when_lost}})
    return Carry(scenario, changes, WINDOW_S).run("lost", loss.name, preset, [loss.event], seed)


@dataclass(frozen=True, slots=True)
class Row:
    """All losses of one kind."""

    name: str
    outcomes: Mapping[Outcome, int]
    tilt_max_deg: float | None
    height_min_m: float | None
    goal_error_m: float | None
    """The worst in the last second."""


def rows_of(losses: Sequence[Loss], judgements: Sequence[Judgement]) -> list[Row]:
    """The worst of each kind of loss, in the order in which they first come, and of all."""
    by_name: dict[str, list[Judgement]] = {}
    for loss, judgement in zip(losses, judgements, strict=True):
        by_name.setdefault(loss.name, []).append(judgement)
    return [_row(name, found) for name, found in by_name.items()] + [_row("all", list(judgements))]


def _row(name: str, judgements: Sequence[Judgement]) -> Row:
    tilts = [each.tilt_max_deg for each in judgements if each.tilt_max_deg is not None]
    heights = [each.height_min_m for each in judgements if each.height_min_m is not None]
    errors = [each.goal_error_m for each in judgements if each.goal_error_m is not None]
    return Row(
        name,
        outcome_counts(judgements),
        max(tilts, default=None),
        min(heights, default=None),
        max(errors, default=None),
    )
