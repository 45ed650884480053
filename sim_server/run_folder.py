"""The folder that a run leaves: run.json, metrics.json, trace.parquet, events.jsonl. (logs/ is the launcher's.)"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TextIO

from sim_server.errors import SimError
from sim_server.metrics import TraceFacts, physical_metrics
from sim_server.scenario import Bound
from sim_server.trace import read_trace
from sim_server.verdict import Judged, judge, overall

RUN, METRICS, TRACE, EVENTS = "run.json", "metrics.json", "trace.parquet", "events.jsonl"


class RunFolderError(SimError):
    """A run folder cannot be made, or what is in it cannot be used."""


class RunFolder:
    """An open run folder; the events file is written line by line.

    Raises:
        RunFolderError: the folder holds a run already, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if (path / RUN).exists():
            raise RunFolderError(f"{path} holds a run already: expected a new folder; choose another with --out")
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._events: TextIO = (path / EVENTS).open("w", encoding="utf-8")
        except OSError as error:
            raise RunFolderError(
                f"cannot write to {path}: {error.strerror}; choose another folder with --out"
            ) from None

    @property
    def trace(self) -> Path:
        """Where the trace goes."""
        return self.path / TRACE

    def event(self, tick: int, time_s: float, kind: str, **details: object) -> None:
        """Append one event and push it out."""
        self._events.write(json.dumps({"tick": tick, "time_s": round(time_s, 6), "kind": kind, **details}) + "\n")
        self._events.flush()

    def close(self) -> None:
        self._events.close()


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(part, path)


def read_run(path: Path) -> dict[str, Any]:
    """The content of a folder's run.json.

    Raises:
        RunFolderError: it is no run folder.
    """
    try:
        content = json.loads((path / RUN).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RunFolderError(f"{path} is no run folder: expected a file {RUN} in it") from None
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{path / RUN} cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise RunFolderError(f"{path / RUN} is no run description: got a {type(content).__name__}")
    return content


def compute_metrics(path: Path) -> tuple[dict[str, Any], tuple[Judged, ...]]:
    """All metrics of a run folder from its trace and run.json, with the verdict, and each bound beside its value.

    Raises:
        RunFolderError: the trace or run.json is missing, cut off, or does not fit.
    """
    run = read_run(path)
    try:
        facts = run["facts"]
        expect = {name: Bound.model_validate(bound) for name, bound in run["scenario"]["expect"].items()}
        metrics: dict[str, Any] = dict(
            physical_metrics(
                read_trace(path / TRACE),
                TraceFacts(
                    arms=tuple(facts["arms"]),
                    goal_m=facts["goal_m"] and tuple(facts["goal_m"]),
                    load_mass_kg=facts["load_mass_kg"],
                    centre_of_mass_m=tuple(facts["centre_of_mass_m"]),
                    grasps_m=facts["grasps_m"],
                    torque_max_Nm=tuple(facts["torque_max_Nm"]),
                ),
            )
        )
        metrics |= run["measured"]
        completed = run["ended"]["completed"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(f"{path}: no metrics can be computed: {type(error).__name__}: {error}") from None
    judged = judge(metrics, expect)
    metrics["verdict"] = overall(judged, completed)
    return metrics, judged
