"""A run played back from its trace: where all bodies were, and which forces acted where. Nothing is simulated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim_server.errors import SimError
from sim_server.layout import Array
from sim_server.marks import LEADER_FORCE, PUSH, PUSH_ON_LOAD, WRIST
from sim_server.metrics import rotation_matrices
from sim_server.run_folder import TRACE, RunFolderError, read_run
from sim_server.scenario import Scenario
from sim_server.scene import locate, rotation
from sim_server.trace import read_trace
from sim_server.world import build_world


@dataclass(frozen=True, eq=False)
class Forces:
    """A force over time.

    Attributes:
        at: point of action in the world, (rows, 3) m.
        force: (rows, 3) N, world.
    """

    at: Array
    force: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """Where everything was, row by row of a trace; NaN where a robot was not there.

    Attributes:
        time_s: (rows,).
        p: positions of the bodies, (rows, bodies, 3) m, in the order of :attr:`Playback.bodies`.
        quat_wxyz: orientations, (rows, bodies, 4).
        hands: tool centre of every arm, (rows, 3) m.
        forces: by name, as in sim_server/marks.py.
    """

    time_s: Array
    p: Array
    quat_wxyz: Array
    hands: dict[str, Array]
    forces: dict[str, Forces]


class Playback:
    """A scenario's world with all robots that ever took part.

    Args:
        scenario: what the run was made of.
        struts: every arm, and its strut (from 0), as in run.json's facts.

    Raises ``LayoutError`` and what else :func:`build_world` raises.
    """

    def __init__(self, scenario: Scenario, struts: Mapping[str, int]) -> None:
        self.world = build_world(scenario, struts, to_look_at=True)
        model = self.world.model
        names = [model.body(k).name for k in range(model.nbody)]
        self._body_ids = np.array([k for k, name in enumerate(names) if name != "world"])
        self.bodies = [names[k] for k in self._body_ids]
        """Names of all bodies."""
        self._row = {name: k for k, name in enumerate(self.bodies)}
        point = scenario.leader.point if scenario.leader else "centre"
        self._pulled = self.world.load_points[point]

    def body_ids(self, arms: Sequence[str]) -> list[int]:
        """Numbers of the bodies of some arms in the model."""
        return [int(k) for k, name in zip(self._body_ids, self.bodies, strict=True) if name.partition("/")[0] in arms]

    def absent(self, trace: Mapping[str, Array], row: int) -> list[str]:
        """The arms that were not there in a row of the trace."""
        return [arm for arm in self.world.arms if not _is_there(trace, arm, row)]

    def place(self, trace: Mapping[str, Array], row: int) -> None:
        """Put everything where that row of the trace has it, in ``world.data``; who was not there stays where he is."""
        qpos = self.world.data.qpos
        qpos[self.world.load_qpos] = np.concatenate([trace["load.position"][row], trace["load.quat_wxyz"][row]])
        for arm, ids in self.world.arms.items():
            if _is_there(trace, arm, row):
                qpos[ids.arm_qpos] = trace[f"{arm}.q"][row]
                if ids.fixed_at is None:
                    qpos[ids.base_qpos] = trace[f"{arm}.base"][row]
        locate(self.world.model, self.world.data)

    def motion(self, trace: Mapping[str, Array], rows: Sequence[int]) -> Motion:
        """Those rows of a trace."""
        world, arms = self.world, self.world.arms
        p, quat = np.empty((len(rows), len(self.bodies), 3)), np.empty((len(rows), len(self.bodies), 4))
        hands = {arm: np.full((len(rows), 3), np.nan) for arm in arms}
        wrists = {arm: Forces(np.full((len(rows), 3), np.nan), np.full((len(rows), 3), np.nan)) for arm in arms}
        for k, row in enumerate(rows):
            self.place(trace, row)
            p[k], quat[k] = world.data.xpos[self._body_ids], world.data.xquat[self._body_ids]
            for arm, ids in arms.items():
                if not _is_there(trace, arm, row):
                    p[k, self._of(arm)] = quat[k, self._of(arm)] = np.nan
                    continue
                hands[arm][k] = world.data.site_xpos[ids.tcp_site]
                wrists[arm].at[k] = world.data.site_xpos[ids.wrist_site]
                wrists[arm].force[k] = rotation(world.data, ids.wrist_site) @ trace[f"{arm}.wrench"][row, :3]
        picked = {name: np.asarray(column)[rows] for name, column in trace.items()}
        return Motion(picked["time_s"], p, quat, hands, dict(self._forces(picked, hands, wrists)))

    def _of(self, arm: str) -> list[int]:
        return [k for k, name in enumerate(self.bodies) if name.startswith(f"{arm}/")]

    def _forces(
        self, trace: Mapping[str, Array], hands: Mapping[str, Array], wrists: Mapping[str, Forces]
    ) -> Iterator[tuple[str, Forces]]:
        p, R = trace["load.position"], rotation_matrices(trace["load.quat_wxyz"])
        yield LEADER_FORCE, Forces(p + R @ self._pulled, trace["leader.force"])
        if "load.disturbance" in trace:  # not in runs of old
            yield PUSH_ON_LOAD, Forces(p + R @ self.world.load_com, trace["load.disturbance"][:, :3])
        for arm, wrist in wrists.items():
            yield f"{arm}/{WRIST}", wrist
            if f"{arm}.disturbance" in trace:
                yield f"{arm}/{PUSH}", Forces(hands[arm], trace[f"{arm}.disturbance"][:, :3])


def thinned(time_s: Array, step_s: float, rate_hz: float) -> list[int]:
    """Numbers of the rows that are enough for so many pictures a second: the first at or after every picture's time.

    The same rows whether a run is cut into blocks or not.

    Args:
        time_s: (rows,), evenly spaced.
        step_s: from one row to the next.
    """
    due = np.floor(time_s * rate_hz + 1e-6)
    before = np.floor((time_s - step_s) * rate_hz + 1e-6)
    rows: list[int] = np.flatnonzero(due != before).tolist()
    return rows


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """A run folder that has been read, ready to be looked at."""

    folder: Path
    about: Mapping[str, Any]
    """Its run.json."""
    scenario: Scenario
    trace: Mapping[str, Array]
    playback: Playback

    @property
    def facts(self) -> Mapping[str, Any]:
        """What run.json says of the robots and the load."""
        facts: Mapping[str, Any] = self.about["facts"]
        return facts

    @property
    def row_s(self) -> float:
        """Simulated time from one row of the trace to the next."""
        return row_s(self.scenario)


def row_s(scenario: Scenario) -> float:
    """Simulated time from one recorded row to the next."""
    return scenario.record.every_ticks * scenario.clock.control_period_ms / 1000


def read_recorded(folder: Path) -> RecordedRun:
    """Read a run folder and build its world.

    Raises:
        RunFolderError: it is no run folder, has no rows, or what is in it does not fit.
    """
    about = read_run(folder)
    try:
        trace, scenario = read_trace(folder / TRACE), Scenario.model_validate(about["scenario"])
        if not trace["time_s"].size:
            raise ValueError("the trace has no rows: the run ended before its first tick")
        return RecordedRun(folder, about, scenario, trace, Playback(scenario, about["facts"]["struts"]))
    except (OSError, ValueError, LookupError, TypeError, SimError) as error:
        problem = " ".join(str(error).split())
        raise RunFolderError(f"{folder}: nothing can be shown of it: {type(error).__name__}: {problem}") from None


def _is_there(trace: Mapping[str, Array], arm: str, row: int) -> bool:
    column = trace.get(f"{arm}.q")
    return column is not None and bool(np.isfinite(column[row]).all())
