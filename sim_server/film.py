"""Pictures of a run, from its trace: the world as it stood at its moments, rendered off-screen.

OpenGL without a screen needs a library of the system's, EGL or OSMesa, named in the environment (MUJOCO_GL) before
MuJoCo is loaded; ``palanquin render`` sees to that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from sim_server.errors import CannotRender
from sim_server.layout import Array
from sim_server.looks import Arrow, Camera
from sim_server.marks import ARROW_M_PER_N, SHORTEST_ARROW_N, force_colour
from sim_server.playback import Forces, RecordedRun

LARGEST = (1280, 720)
"""Pixels of the off-screen buffer that a world's model asks for."""


def shoot(
    run: RecordedRun, times_s: Sequence[float], size: tuple[int, int] = LARGEST, *, marks: bool = True
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """The world of a run at moments of its trace: the row that was nearest, and the picture, (height, width, 3).

    The camera stands still, so that who looks sees what has moved.

    Args:
        times_s: simulated times.
        size: width and height, pixels, at most :data:`LARGEST`.
        marks: with the goal and the forces.

    Raises:
        CannotRender: OpenGL is missing.
    """
    trace, playback = run.trace, run.playback
    way = trace["load.position"]
    middle = (way.min(axis=0) + way.max(axis=0)) / 2
    span = max(run.scenario.load.size_m) + 0.5 * float(np.ptp(way[:, :2], axis=0).max())
    lookat, distance = np.array([*middle[:2], 0.25]), 1.6 + 1.2 * span
    goal = np.array(run.facts["goal_m"]) if marks and run.facts["goal_m"] else None
    world = playback.world
    with _saying_what_is_missing(), Camera(world.model, lookat, distance, size) as camera:
        for time_s in times_s:
            row = int(np.argmin(np.abs(trace["time_s"] - time_s)))
            forces = playback.motion(trace, [row]).forces if marks else {}
            playback.place(trace, row)
            without = playback.body_ids(playback.absent(trace, row))
            yield row, camera.shoot(world.data, arrows=_arrows(forces), goal=goal, without=without)


def _arrows(forces: dict[str, Forces]) -> list[Arrow]:
    first: list[tuple[str, Array, Array]] = [(name, each.at[0], each.force[0]) for name, each in forces.items()]
    return [
        Arrow(at, ARROW_M_PER_N * force, force_colour(name))
        for name, at, force in first
        if np.linalg.norm(force) > SHORTEST_ARROW_N  # not where it is NaN either
    ]


@contextmanager
def _saying_what_is_missing() -> Iterator[None]:
    try:
        yield
    except (ImportError, RuntimeError, AttributeError, OSError) as error:  # what is missing decides which
        raise CannotRender(error) from None
