"""What the runs of a report left, read when it is asked for."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from deploy.batch import COST
from deploy.paper.statistics import Spread, spread
from deploy.planned_run import Run
from sim_server.run_folder import METRICS, RUN, TRACE
from sim_server.trace import read_trace

Array = NDArray[np.float64]


class NoSuchRun(LookupError):
    """A run that a report does not have."""


class Results:
    """All runs of one report.

    Args:
        root: the folder under which they lie.
        runs: those that are there.
    """

    def __init__(self, root: Path, runs: Iterable[Run]) -> None:
        self._root = root
        self._runs: dict[tuple[str, str, str], dict[int, Run]] = {}
        for run in runs:
            self._runs.setdefault((run.group, run.condition, run.law), {})[run.seed] = run

    def seeds(self, group: str, condition: str, law: str) -> Sequence[int]:
        """Seeds of which there is a run."""
        return sorted(self._runs.get((group, condition, law), {}))

    def run(self, group: str, condition: str, law: str, seed: int) -> Run:
        """One run. Raises :class:`NoSuchRun` if it is not there."""
        try:
            return self._runs[group, condition, law][seed]
        except KeyError:
            raise NoSuchRun(f"{group}/{condition}/{law}/seed-{seed}") from None

    def trace(self, run: Run) -> Mapping[str, Array]:
        """Its trace."""
        return _trace(self._root / run.place)

    def metrics(self, run: Run) -> Mapping[str, Any]:
        """Its metrics."""
        return _json(self._root / run.place / METRICS)

    def about(self, run: Run) -> Mapping[str, Any]:
        """Its run.json."""
        return _json(self._root / run.place / RUN)

    def cost(self, run: Run) -> Mapping[str, float] | None:
        """Its wall and processor time, if that was measured."""
        file = self.folder(run) / COST
        return _json(file) if file.exists() else None

    def folder(self, run: Run) -> Path:
        """Where it lies."""
        return self._root / run.place

    def spread(self, metric: str, group: str, condition: str, law: str) -> Spread | None:
        """A metric over all seeds of a condition."""
        runs = self._runs.get((group, condition, law), {}).values()
        return spread(_number(self.metrics(run).get(metric)) for run in runs)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None


@lru_cache(maxsize=8)
def _trace(folder: Path) -> Mapping[str, Array]:
    return read_trace(folder / TRACE)


@lru_cache(maxsize=4096)
def _json(path: Path) -> Mapping[str, Any]:
    found: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def hand_places(trace: Mapping[str, Array], arm: str = "a1", model: str = "panda") -> Array:
    """Where an arm's hand was, (rows, 3) m in its base frame, by the description of the arm and its true joints."""
    description = ArmModel(model)
    return np.array([description.hand(q)[0] for q in trace[f"{arm}.q"]])
