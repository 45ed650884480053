"""What is run for the report: every condition of section VI, its variants and seeds, and the ablations.

A :class:`Run` is one ``palanquin run``. What it is follows from its scenario, its changes and its seed alone, so that a
report that was interrupted goes on with what is missing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
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
SHORT_S: Mapping[str, Changes] = {
    "VI-A": {},
    "VI-B": {"duration_s": 12.0},
    "VI-C": {"duration_s": 12.0},
}
"""What is cut of a short run: three periods of the trajectory are left; a carry just arrives."""

RECORD: Changes = {"record": {"every_ticks": 10, "checkpoint_s": 0.0}}
"""100 rows per simulated second are enough for every claim, and no run here is resumed in its middle."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition of an experiment."""

    name: str
    label: str
    """As figures and tables say it."""
    scenario: str
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
            presets=("fixed", "paper"),
        ),
    ),
    "VI-C": (
        Condition("undisturbed", "no disturbance", "transport"),
        Condition("pushed", "50 N for 2 s across", "transport-pushed"),
        Condition("pushed-along", "50 N for 2 s along", "transport-pushed-along"),
        Condition("twisted", "a torque in the plane", "transport-twisted"),
        Condition("failed-grasp", "one grasp fails", "failed-grasp"),
    ),
}
"""The experiments of section VI, each with its conditions."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run of the report."""

    group: str
    """The experiment, or the ablation, that it belongs to."""
    condition: str
    variant: str
    """The preset, or an ablation's value."""
    scenario: str
    changes: Changes
    seed: int

    @property
    def name(self) -> str:
        """Where its run folder lies, under the report's."""
        return f"{self.group}/{self.condition}/{self.variant}/seed-{self.seed}"

    def resolved(self) -> dict[str, Any]:
        """The whole scenario as the simulator gets it."""
        changes = merged(self.changes, {"seed": self.seed})
        return load_scenario(self.scenario, changes).scenario.model_dump(mode="json")

    def digest(self) -> str:
        """SHA-256 (hex) of that: two runs with the same one are the same run."""
        return hashlib.sha256(json.dumps(self.resolved(), sort_keys=True).encode()).hexdigest()

    def settings(self) -> list[str]:
        """Its changes as ``--set`` takes them."""
        return [f"{key}={_toml(value)}" for key, value in _flat(self.changes)]


def section_vi_runs(seeds: range, *, short: bool = False) -> Iterator[Run]:
    """Every run of the experiments; ``short`` ones are cut to what still shows the claim."""
    for group, conditions in SECTION_VI.items():
        for condition in conditions:
            for preset in condition.presets:
                changes = merged(merged(RECORD, START_DIFFERS), merged(PRESETS[preset], condition.changes))
                if short:
                    changes = merged(changes, SHORT_S[group])
                for seed in seeds:
                    yield Run(group, condition.name, preset, condition.scenario, changes, seed)


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
