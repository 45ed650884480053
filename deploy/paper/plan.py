"""What is run for the report: every condition of section VI, its laws and seeds, and the ablations.

A :class:`Run` is one ``palanquin run``. What it is follows from its scenario, its changes and its seed alone, and so
does the folder that it lies in: a report that was interrupted goes on with what is missing, and what two experiments
ask for is run once.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from sim_server.scenario_files import load_scenario

Changes = Mapping[str, Any]
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
LATE_S, SOON_S = 16.0, 10.0
"""Of one that is turned or pushed aside and comes late, and of one that is not."""


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
        Condition("pushed-along", "50 N for 2 s along", "transport-pushed-along", SOON_S),
        Condition("twisted", "a torque in the plane", "transport-twisted", SOON_S),
        Condition("failed-grasp", "one grasp fails", "failed-grasp", LATE_S),
    ),
}
"""The experiments of section VI, each with its conditions."""


@dataclass(frozen=True)
class Run:
    """One run of the report."""

    group: str
    """The experiment, or the ablation, that it belongs to."""
    condition: str
    """The condition, or the ablation's value."""
    law: Preset
    scenario: str
    changes: Changes
    seed: int

    @property
    def name(self) -> str:
        """As tables and messages say it."""
        return f"{self.group}/{self.condition}/{self.law}/seed-{self.seed}"

    @property
    def place(self) -> str:
        """Where its run folder lies, under the report's."""
        return f"{self.scenario}/seed-{self.seed}-{self.digest[:12]}"

    @property
    def command(self) -> str:
        """That makes it again."""
        settings = [word for setting in self.settings() for word in ("--set", setting)]
        return shlex.join(["palanquin", "run", self.scenario, "--seed", str(self.seed), *settings])

    def resolved(self) -> dict[str, Any]:
        """The whole scenario as the simulator gets it."""
        changes = merged(self.changes, {"seed": self.seed})
        return load_scenario(self.scenario, changes).scenario.model_dump(mode="json")

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of that: two runs with the same one are the same run."""
        return hashlib.sha256(json.dumps(self.resolved(), sort_keys=True).encode()).hexdigest()

    def settings(self) -> list[str]:
        """Its changes as ``--set`` takes them."""
        return [f"{key}={_toml(value)}" for key, value in _flat(self.changes)]


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


def merged(below: Changes, above: Changes) -> dict[str, Any]:
    """Nested tables laid over each other; what is above wins."""
    both = dict(below)
    for key, value in above.items():
        under = both.get(key)
        both[key] = merged(under, value) if isinstance(value, Mapping) and isinstance(under, Mapping) else value
    return both


def _flat(changes: Changes, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in changes.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _toml(value: Any) -> str:
    """A plain value as TOML writes it, which for numbers, texts and lists of them is JSON."""
    return json.dumps(list(value) if isinstance(value, tuple) else value)
