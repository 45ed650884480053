"""Checkpoints: everything that a run needs to go on in another process, put together from those who own it.

Agents are no part of it. Whoever was in when the simulator was killed greets the next one anew; a follower's law begins
anew as well, as after any start of its process.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sim_server.checkpoint_file import (
    FOLDER,
    Checkpoint,
    checkpoint_path,
    last_checkpoint,
    versions,
    write_checkpoint,
)
from sim_server.disk import Disk
from sim_server.happenings import Happenings
from sim_server.lockstep import Ticker
from sim_server.mujoco_plant import MujocoPlant
from sim_server.reception import LEADER, Reception
from sim_server.run_folder import RunFolder
from sim_server.scenario_files import NamedScenario
from sim_server.snapshot import pack
from sim_server.trace import TraceWriter
from sim_server.trace_rows import Segment


@dataclass(frozen=True, slots=True)
class Owners:
    """Everybody who owns a part of a run's state."""

    plant: MujocoPlant
    reception: Reception
    clock: Ticker
    happenings: Happenings
    invite: Callable[[str], None]
    """Expects the agent of a robot that has come in the run."""


@dataclass(slots=True)
class Story:
    """How a run came to where it is, over all simulators that had it."""

    started_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    wall_s: float = 0.0
    """Wall time of the ticks before this simulator's first."""
    resumed: list[dict[str, Any]] = field(default_factory=list)
    """When, and from which tick, it was gone on with."""


class Checkpoints:
    """Writes the checkpoints of one run, and brings a run back to one.

    Args:
        folder: of the run.
        run: its name.
        named: its scenario.
        owners: of its state.
        disk: writes them.
    """

    def __init__(self, folder: RunFolder, run: str, named: NamedScenario, owners: Owners, disk: Disk) -> None:
        self._folder, self._owners, self._disk = folder, owners, disk
        scenario = named.scenario
        self._every = round(scenario.record.checkpoint_s * 1000 / scenario.clock.control_period_ms)
        if scenario.record.checkpoint_s:
            self._every = max(1, self._every)
        self._about = {
            "run": run,
            "scenario_name": named.name,
            "scenario_source": named.source,
            "scenario": scenario.model_dump(mode="json"),
            "versions": versions(),
        }
        self.story = Story()
        self._took_ns: list[int] = []
        self._bytes = 0
        """Size of the last one."""
        self._last: Path | None = None

    def is_due(self, tick: int) -> bool:
        """Whether one is to be written before this tick."""
        return self._every > 0 and tick % self._every == 0

    def write(self, trace: TraceWriter, wall_s: float) -> None:
        """Have a checkpoint of this moment, between two ticks, put in the place of the last one, after the rows of the
        trace that belong to it.

        Raises:
            DiskFailed: rows or a checkpoint before this could not be written.
        """
        start = time.perf_counter_ns()
        if self._last is None:
            (self._folder.path / FOLDER).mkdir(exist_ok=True)
        owners, story = self._owners, self.story
        body = pack(
            {
                **self._about,
                "started_at": story.started_at.isoformat(),
                "wall_s": wall_s,
                "resumed": story.resumed,
                "trace": [[list(segment.arms), segment.rows] for segment in trace.segments()],
                "timings": owners.clock.timings.state(),
                "events_bytes": self._folder.events_bytes(),
                "plant": owners.plant.state(),
                "agents": owners.reception.state(),
                "tallies": owners.reception.tallies.state(),
                "punctuality": owners.clock.punctuality.state(),
                "edge": owners.clock.edge.state(),
                "happenings": owners.happenings.state(),
            }
        )
        # Last of all, and close together: from here on another thread wants a share of this process.
        trace.flush()
        file = checkpoint_path(self._folder.path, owners.plant.tick)
        self._disk.do(partial(write_checkpoint, file, body, self._last))
        self._last, self._bytes = file, len(body)
        self._took_ns.append(time.perf_counter_ns() - start)

    def restore(self, checkpoint: Checkpoint) -> tuple[Segment, ...]:
        """Bring everybody back to a checkpoint; the rows of the trace that are kept. Writes nothing.

        Raises:
            CheckpointError: its content does not fit.
        """
        content, owners = checkpoint.content, self._owners
        self._last = last_checkpoint(checkpoint.folder)
        with checkpoint.taking_back():
            owners.plant.restore(content["plant"])
            for agent in content["agents"]["agents"]:
                if agent != LEADER:
                    owners.invite(agent)
            owners.reception.restore(content["agents"])
            owners.clock.punctuality.restore(content["punctuality"])
            owners.clock.edge.restore(content["edge"])
            owners.happenings.restore(content["happenings"])
            owners.clock.timings.restore(content["timings"])
            now, plant = datetime.now(UTC).isoformat(timespec="seconds"), owners.plant
            self.story = Story(
                datetime.fromisoformat(content["started_at"]),
                float(content["wall_s"]),
                [*content["resumed"], {"at": now, "tick": plant.tick, "time_s": round(plant.time_s, 6)}],
            )
            return tuple(Segment(tuple(map(str, arms)), int(rows)) for arms, rows in content["trace"])

    def describe(self) -> Mapping[str, Any]:
        """For run.json: how many, what they cost the ticks before which they were taken, and what each thing that was
        written (rows of the trace, and checkpoints) took the thread that writes."""
        return {
            "written": len(self._took_ns),
            "bytes": self._bytes,
            "ms": _spread(self._took_ns),
            "writing_ms": _spread(self._disk.took_ns),
        }


def _spread(took_ns: Sequence[int]) -> Mapping[str, float]:
    took_ms = np.array(took_ns or [0]) / 1e6
    return {"p50": float(np.percentile(took_ms, 50)), "max": float(took_ms.max())}
