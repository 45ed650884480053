"""Pictures of a run, from its trace: the world as it stood at a moment, rendered off-screen.

OpenGL without a screen needs a library of the system's, EGL or OSMesa, named in the environment (MUJOCO_GL) before
MuJoCo is loaded; ``palanquin render`` sees to that.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_server.errors import SimError
from sim_server.layout import Array
from sim_server.run_folder import TRACE, RunFolderError, read_run
from sim_server.scenario import Scenario
from sim_server.scene import photograph, refresh
from sim_server.trace import read_trace
from sim_server.world import World, build_world

SIZE = (1280, 720)
MISSING_GL = (
    "no picture can be rendered: MuJoCo found no library for off-screen OpenGL ({problem}); expected EGL (Debian: "
    "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri) or OSMesa (libosmesa6, with MUJOCO_GL=osmesa)"
)


class CannotRender(SimError):
    """There is nothing to render with."""

    exit_status = 3


def draw_still(folder: Path, time_s: float, size: tuple[int, int] = SIZE) -> NDArray[np.uint8]:
    """The world of a run at a moment of its trace, (height, width, 3).

    Args:
        time_s: simulated time; the recorded row that is nearest counts.

    Raises:
        RunFolderError: it is no run folder, or has no rows.
        CannotRender: OpenGL is missing.
    """
    about = read_run(folder)
    try:
        trace, scenario = read_trace(folder / TRACE), Scenario.model_validate(about["scenario"])
        row = int(np.argmin(np.abs(trace["time_s"] - time_s)))
        world = stand(scenario, about, trace, row)
    except (OSError, ValueError, LookupError, TypeError) as error:
        problem = " ".join(str(error).split())
        raise RunFolderError(f"{folder}: nothing can be rendered of it: {type(error).__name__}: {problem}") from None
    way = trace["load.position"]
    middle = (way.min(axis=0) + way.max(axis=0)) / 2  # the same for all of a run: who looks sees what has moved
    span = max(scenario.load.size_m) + 0.5 * float(np.ptp(way[:, :2], axis=0).max())
    try:
        return photograph(world.model, world.data, np.array([*middle[:2], 0.45]), 2.2 + 1.6 * span, size)
    except (ImportError, RuntimeError, AttributeError, OSError) as error:  # what is missing decides which
        raise CannotRender(MISSING_GL.format(problem=f"{os.environ.get('MUJOCO_GL', 'default')}: {error}")) from None


def stand(scenario: Scenario, about: Mapping[str, Any], trace: Mapping[str, Array], row: int) -> World:
    """The world with everything where that row of the trace has it."""
    there = [arm for arm in about["facts"]["arms"] if np.isfinite(trace[f"{arm}.q"][row]).all()]
    world = build_world(scenario, {arm: about["facts"]["struts"][arm] for arm in there}, to_look_at=True)
    qpos = world.data.qpos
    qpos[world.load_qpos] = np.concatenate([trace["load.position"][row], trace["load.quat_wxyz"][row]])
    for arm in there:
        ids = world.arms[arm]
        qpos[ids.arm_qpos] = trace[f"{arm}.q"][row]
        if ids.fixed_at is None:
            qpos[ids.base_qpos] = trace[f"{arm}.base"][row]
    refresh(world.model, world.data)
    return world
