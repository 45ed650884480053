"""What a run left, as the invariants look at it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.batch import COST
from sim_server.run_folder import AUDIT, EVENTS, TRACE, RunFolderError, read_audit, read_run
from sim_server.trace import read_trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Record:
    """One run."""

    trace: Mapping[str, Array]
    """The columns of sim_server/trace.py; there is at least one row, and the load's are finite."""
    events: Sequence[Mapping[str, Any]]
    """events.jsonl without what a resumed run has undone."""
    run: Mapping[str, Any]
    """run.json."""
    audit: Mapping[str, Any] | None = None
    """audit.json; None for a run that was not audited."""
    left_over: Sequence[str] | None = None
    """Command lines of its processes that were there after its end; None if nobody looked."""

    @property
    def completed(self) -> bool:
        """Whether it reached its end."""
        return bool(self.run["ended"]["completed"])

    @property
    def schedule(self) -> Sequence[Mapping[str, Any]]:
        """The events of its scenario."""
        found: Sequence[Mapping[str, Any]] = self.run["scenario"]["events"]
        return found

    @property
    def struck(self) -> frozenset[str]:
        """Agents and arms that an event of the scenario is about."""
        named = (event.get("agent") or event.get("arm") for event in self.schedule)
        return frozenset(str(name) for name in named if name)


def read_record(folder: Path) -> Record:
    """Read a run folder.

    Raises:
        RunFolderError: something is missing, cut off, or does not fit.
    """
    run = read_run(folder)
    try:
        trace = read_trace(folder / TRACE)
        lines = (folder / EVENTS).read_text(encoding="utf-8").splitlines()
        events = [event for event in map(json.loads, lines) if not event.get("undone")]
        record = Record(trace, events, run, _audit(folder), _left_over(folder))
        load = np.concatenate([trace[f"load.{name}"] for name in ("position", "quat_wxyz", "linear_velocity")], axis=1)
        finite = bool(load.size) and bool(np.isfinite(load).all())
        _ = record.completed, record.struck, run["facts"]["arms"], run["facts"]["torque_max_Nm"]
    # An edited or cut-off folder can fail in any of these ways; each means the same.
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise RunFolderError(f"{folder}: cannot be judged: {type(error).__name__}: {error}") from None
    if not finite:
        raise RunFolderError(f"{folder / TRACE}: cannot be judged: the load's columns are empty or hold no numbers")
    return record


def _audit(folder: Path) -> Mapping[str, Any] | None:
    return read_audit(folder) if (folder / AUDIT).exists() else None


def _left_over(folder: Path) -> Sequence[str] | None:
    """As the batch saw it when the run's command had ended."""
    try:
        found = json.loads((folder / COST).read_text(encoding="utf-8")).get("left_over")
    except FileNotFoundError:
        return None
    return None if found is None else [str(line) for line in found]
