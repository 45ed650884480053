"""A process that draws: what renders off-screen has to be chosen before MuJoCo is loaded, and tests have it loaded.

Writes one compressed file of pictures. Run as ``python drawn.py FILE``, with MUJOCO_GL in the environment.
"""

from __future__ import annotations

import sys

import numpy as np
from plants import scenario

from sim_server.looks import Arrow, Camera
from sim_server.world import build_world

GOAL, START, DOWN = np.array([3.0, 0.0]), np.array([3.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
BLACK = (0.0, 0.0, 0.0)


def main(file: str) -> None:
    """The goal alone, with an arrow down to it, with one half as long; the world, without a robot, and again."""
    world = build_world(scenario(count=2), to_look_at=True)
    robot = [k for k in range(world.model.nbody) if world.model.body(k).name.startswith("a1/")]
    with Camera(world.model, np.array([1.5, 0.0, 0.5]), 4.0, (320, 180)) as camera:
        np.savez(
            file,
            goal=camera.shoot(world.data, goal=GOAL),
            whole_arrow=camera.shoot(world.data, goal=GOAL, arrows=[Arrow(START, DOWN, BLACK)]),
            half_arrow=camera.shoot(world.data, goal=GOAL, arrows=[Arrow(START, DOWN / 2, BLACK)]),
            world=camera.shoot(world.data),
            without=camera.shoot(world.data, without=robot),
            again=camera.shoot(world.data),
        )


if __name__ == "__main__":
    main(sys.argv[1])
