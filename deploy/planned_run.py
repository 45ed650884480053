"""One run of a batch: a scenario, what is changed of it, and a seed.

What it is follows from these alone, and so does the folder that it lies in: a batch that was interrupted goes on with
what is missing, and what two parts of it ask for is run once.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from deploy.settings import toml_value
from sim_server.scenario_files import load_scenario

Changes = Mapping[str, Any]


@dataclass(frozen=True)
class Run:
    """One ``palanquin run`` of a batch."""

    group: str
    """The experiment, the ablation or the matrix that it belongs to."""
    condition: str
    """The condition, the ablation's value or the fault."""
    law: str
    """As tables say it; what it is stands in the changes."""
    scenario: str
    changes: Changes
    seed: int
    may_lose: bool = False
    """Whether somebody may be lost in it. If not, a run that loses somebody is not the one that was asked for."""

    @property
    def name(self) -> str:
        """As tables and messages say it."""
        return f"{self.group}/{self.condition}/{self.law}/seed-{self.seed}"

    @property
    def place(self) -> str:
        """Where its run folder lies, under the batch's."""
        return f"{Path(self.scenario).stem}/seed-{self.seed}-{self.digest[:12]}"

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
        return as_settings(self.changes)


def as_settings(changes: Changes) -> list[str]:
    """Changes of a scenario as ``--set`` takes them, ``KEY=VALUE``."""
    return [f"{key}={toml_value(value)}" for key, value in _flat(changes)]


def merged(below: Changes, above: Changes) -> dict[str, Any]:
    """Nested tables laid over each other; what is above wins."""
    both = dict(below)
    for key, value in above.items():
        under = both.get(key)
        both[key] = merged(under, value) if isinstance(value, Mapping) and isinstance(under, Mapping) else value
    return both


def _flat(changes: Changes, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The single values of nested tables, by dotted keys."""
    for key, value in changes.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
