"""Runs without processes for tests of what is seen of them: a plant that is stepped, its rows, and a run folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plants import NO_STIFFNESS

from sim_server.mujoco_plant import MujocoPlant
from sim_server.trace import TraceWriter, columns

Array = NDArray[Any]
EVERY = 5
GRAVITY = np.array([0.0, 0.0, -9.81])


def rows_of(plant: MujocoPlant, ticks: int) -> list[list[Array]]:
    """What is recorded of so many ticks, as a simulator does, while the arms are told to bear what they bore."""
    rows = []
    torque = {name: tuple(reading.tau) for name, reading in plant.read().items()}
    for tick in range(ticks):
        for name in plant.world.arms:
            plant.command(name, torque[name], (0.0, 0.0, 0.0), tuple(NO_STIFFNESS.tolist()), 0.0)
        before = plant.state_row() if tick % EVERY == 0 else None
        plant.step()
        if before is not None:
            rows.append([part.copy() for part in plant.force_row(before)])
    return rows


def trace_of(plant: MujocoPlant, rows: Sequence[Sequence[Array]]) -> dict[str, Array]:
    """The rows as the trace has them."""
    whole, start, trace = np.array([np.concatenate(row) for row in rows]), 0, {}
    for name, width in columns(plant.world.arms, 7).items():
        trace[name] = whole[:, start : start + width] if width > 1 else whole[:, start]
        start += width
    return trace


def write_folder(folder: Path, plant: MujocoPlant, rows: Sequence[Sequence[Array]]) -> Path:
    """As much of a run folder as is needed to look at it."""
    folder.mkdir()
    writer = TraceWriter(folder / "trace.parquet", plant.world.arms, 7)
    for row in rows:
        writer.append(list(row))
    writer.close()
    writer.forget()
    world = plant.world
    facts = {
        "arms": list(world.arms),
        "goal_m": list(world.scenario.leader.goal_m) if world.scenario.leader else None,
        "load_mass_kg": world.load_mass,
        "centre_of_mass_m": world.load_com.tolist(),
        "struts": {name: ids.strut for name, ids in world.arms.items()},
        "grasps_m": {name: world.struts[ids.strut].p.tolist() for name, ids in world.arms.items()},
        "torque_max_Nm": [87.0] * 4 + [12.0] * 3,
    }
    about = {"scenario_name": "test", "seed": 1, "scenario": world.scenario.model_dump(mode="json"), "facts": facts}
    (folder / "run.json").write_text(json.dumps(about))
    events: list[dict[str, Any]] = [
        {"tick": 0, "time_s": 0.0, "kind": "joined", "agent": "a1", "lease": 1, "pid": 1},
        {"tick": 10, "time_s": 0.01, "kind": "lost", "agent": "a1", "why": "its sign of life is gone", "then": "limp"},
    ]
    (folder / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    return folder
