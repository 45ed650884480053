"""What is run for the report: every condition of section VI, its laws and seeds, and the ablations.

Each is a :class:`deploy.planned_run.Run`, so what two experiments ask for is run once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from deploy.planned_run import Changes, Run, merged

Preset = Literal["paper", "fixed", "palanquin"]

PRESETS: Mapping[Preset, Changes] = {
    "paper": {},
    "fixed": {"team": {"gains": {"adaptive": False}}},
    "palanquin": {"team": {"controller": "palanquin"}},
}
"""The laws that are compared: the paper's, the same with fixed stiffness, and ours."""

START_DIFFERS: Changes = {"plant": {"start_offset_m": 0.005, "start_yaw_rad": 0.01}}
"""Small changes of how the robots stand at the start, drawn from each seed."""
RECORD: Changes = {"record": {"every_ticks": 10, "checkpoint_s": 0.0}}
"""100 rows per simulated second are enough for every claim, and no run here is resumed in its middle."""


CARRY_S = 12.0
"""Simulated time of a carry: the paper's law arrives after 8 s."""
PUSHED_S, LATE_S = 14.0, 16.0
"""Of one that is held up by a push, and of one that is turned aside and comes late."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition of an experiment."""

    name: str
    label: str
    """As figures and tables say it."""
    scenario: str
    duration_s: float = CARRY_S
    changes: Changes = field(default_factory=dict)
    presets: tuple[Preset, ...] = ("paper", "palanquin")


SECTION_VI: Mapping[str, tuple[Condition, ...]] = {
    "VI-A": (
        Condition("smooth", "smoothly varying forces", "hold-smooth"),
        Condition("abrupt", "stochastic, abrupt forces", "hold-abrupt"),
    ),
    "VI-B": (
        Condition(
            "trajectory",
            "2.5 kg unknown, height 0.1 m at 0.25 Hz",
            "trajectory",
            presets=("fixed", "paper", "palanquin"),
        ),
    ),
    "VI-C": (
        Condition("undisturbed", "no disturbance", "transport"),
        Condition("pushed", "50 N for 2 s across", "transport-pushed", LATE_S),
        Condition("pushed-along", "50 N for 2 s along", "transport-pushed-along", PUSHED_S),
        Condition("twisted", "a torque in the plane", "transport-twisted", PUSHED_S),
        Condition("failed-grasp", "one grasp fails", "failed-grasp", LATE_S),
    ),
}
"""The experiments of section VI, each with its conditions."""


def section_vi_runs(seeds: range, presets: Sequence[Preset] = tuple(PRESETS)) -> Iterator[Run]:
    """Every run of the experiments with these laws."""
    for group, conditions in SECTION_VI.items():
        for condition in conditions:
            for preset in condition.presets:
                if preset in presets:
                    for seed in seeds:
                        changes = condition_changes(condition, preset)
                        yield Run(group, condition.name, preset, condition.scenario, changes, seed)


def condition_changes(condition: Condition, preset: Preset) -> dict[str, Any]:
    """What a condition with this law changes of its scenario."""
    changes = merged({"duration_s": condition.duration_s}, merged(RECORD, START_DIFFERS))
    return merged(changes, merged(PRESETS[preset], condition.changes))
