"""Rows, events and reports of progress made by hand, as a simulator tells them to observers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

import numpy as np

from sim_server.trace_columns import columns
from wire.messages import Event, Progress, Row


def row(
    tick: int = 0, arms: int = 4, joints: int = 7, values: Mapping[str, Sequence[float] | float] | None = None
) -> Row:
    """A level load at (0, 0), 0.8 m up, with so many arms around it, each of which bears 50 N; ``values`` by column."""
    names = [f"a{k + 1}" for k in range(arms)]
    told: dict[str, Sequence[float] | float] = {
        "load.position": (0.0, 0.0, 0.8),
        "load.quat_wxyz": (1.0, 0.0, 0.0, 0.0),
    }
    for k, name in enumerate(names):
        angle = 2 * math.pi * (k + 0.5) / arms
        base = (1.5 * math.cos(angle), 1.2 * math.sin(angle), angle + math.pi)
        told |= {f"{name}.base": base, f"{name}.grip": (1.0, 2.0, 50.0, 0.0, 0.0, 0.0), f"{name}.stiffness": 400.0}
    told |= values or {}
    named = {name: width for name, width in columns(names, joints).items() if name not in ("tick", "time_s")}
    assert set(told) <= set(named)
    parts = [np.broadcast_to(np.asarray(told.get(name, 0.0), float), (width,)) for name, width in named.items()]
    struts = " ".join(str(k + 1) for k in range(arms))
    return Row(tick, 900_000, " ".join(names), struts, np.concatenate(parts).astype("<f8").tobytes())


def progress(tick: int = 0, ticks: int = 10_000, phase: str = "running", waiting_for: str = "") -> Progress:
    """Of a run of one-millisecond ticks with a goal 1.5 m away."""
    return Progress(phase, waiting_for, tick, ticks, tick / 1000, 0.95, 0.25, 1.5, 0, 0)  # type: ignore[arg-type]


def event(kind: str, tick: int = 0, **details: object) -> Event:
    return Event(tick, tick / 1000, kind, json.dumps(details))


def tilted(degrees: float) -> tuple[float, float, float, float]:
    """A quaternion, w first, of a tilt about x."""
    half = math.radians(degrees) / 2
    return math.cos(half), math.sin(half), 0.0, 0.0
