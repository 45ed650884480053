"""What a good run leaves, made by hand, and ways to spoil it in one place."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from deploy.chaos.record import Record
from sim_server.run_folder import EVENTS, METRICS, RUN, TRACE

ROWS, EVERY = 601, 5
"""Three seconds, a row every five ticks of a millisecond."""
ARMS = ("a1", "a2", "a3")


def told(kind: str, tick: int, **more: object) -> dict[str, Any]:
    return {"tick": tick, "time_s": tick / 1000, "kind": kind, **more}


def good_trace() -> dict[str, Any]:
    """A load goes one metre along x within two seconds, level, and stands; every hand bears 50 N."""
    time_s = np.arange(ROWS) * EVERY / 1000
    along = np.clip(time_s / 2.0, 0.0, 1.0)
    trace: dict[str, Any] = {
        "tick": np.arange(ROWS) * EVERY,
        "time_s": time_s,
        "load.position": np.column_stack([along, 0 * along, 0.1 + 0 * along]),
        "load.quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (ROWS, 1)),
        "load.linear_velocity": np.column_stack([np.where(time_s < 2.0, 0.5, 0.0), 0 * along, 0 * along]),
    }
    for arm in ARMS:
        trace[f"{arm}.tau"] = np.full((ROWS, 2), 5.0)
        trace[f"{arm}.grip"] = np.tile([0.0, 0.0, 50.0, 0.0, 0.0, 0.0], (ROWS, 1))
    return trace


def record(
    spoil: Callable[[dict[str, Any]], object] = lambda trace: None,
    events: tuple[dict[str, Any], ...] = (),
    schedule: tuple[Mapping[str, Any], ...] = (),
    **changed: Any,
) -> Record:
    """A good run, but for what is spoiled."""
    trace = good_trace()
    spoil(trace)
    run = {
        "scenario": {"events": list(schedule), "expect": {}, "load": {"size_m": [1.6, 0.9, 0.75]}},
        "facts": {"arms": list(ARMS), "goal_m": [1.0, 0.0], "torque_max_Nm": [10.0, 8.0]},
        "ended": {"completed": True, "why": "reached its duration"},
    } | changed
    audit = {"verdict": "holds", "why": ["no key of an agent was heard by anybody else"]}
    lines = sorted([told("started", 0), *events, told("ended", 3000)], key=lambda event: event["tick"])
    return Record(trace, lines, run, audit, ())


def put(column: str, rows: slice | int, value: object) -> Callable[[dict[str, Any]], object]:
    return lambda trace: trace[column].__setitem__(rows, value)


def quat(about_x_deg: float) -> list[float]:
    half = np.radians(about_x_deg) / 2
    return [float(np.cos(half)), float(np.sin(half)), 0.0, 0.0]


def left_in(folder: Path, of: Record) -> Path:
    """The run folder of a record, as far as it is judged; this folder is there already."""
    columns = {
        name: pa.array(values) if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(values.ravel(), len(values.T))
        for name, values in of.trace.items()
    }
    pq.write_table(pa.table(columns), folder / TRACE)
    (folder / EVENTS).write_text("".join(json.dumps(event) + "\n" for event in of.events))
    (folder / RUN).write_text(json.dumps(of.run))
    (folder / METRICS).write_text("{}")
    return folder
