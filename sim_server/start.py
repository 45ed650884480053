"""Where a run starts: load and bases a little beside where they are meant to be, by the seed, and the hands on the
struts all the same."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from sim_server.layout import Array, Pose
from sim_server.scenario import Scenario, arm_number
from sim_server.scene import locate, rotation, site_jacobian

STREAM, LOAD_STREAM = 3, 4
"""Keep these draws apart from other streams of the same seed: noise is stream 1, plant differences are stream 2."""
REACHED = 1e-12
"""Of a hand's way to its strut, m and rad."""
ROUNDS = 30


def displaced_load(scenario: Scenario, X_WO: Pose) -> Pose:
    """The load, and the whole team with it, moved and turned in the plane."""
    moved = _displacement(scenario, np.random.default_rng([scenario.seed, LOAD_STREAM]))
    return Pose(X_WO.p + moved.p, X_WO.R @ moved.R)


def displaced_base(scenario: Scenario, arm: str, X_WB: Pose) -> Pose:
    """One robot's base, moved and turned under its hand, which stays. Depends on nothing else, as its differences."""
    return X_WB.compose(_displacement(scenario, np.random.default_rng([scenario.seed, STREAM, arm_number(arm)])))


def _displacement(scenario: Scenario, rng: np.random.Generator) -> Pose:
    x, y, turn = rng.uniform(-1.0, 1.0, 3)
    plant = scenario.plant
    return Pose.planar(plant.start_offset_m * x, plant.start_offset_m * y, 0.0, plant.start_yaw_rad * turn)


def reach_struts(model: Any, data: Any, hands: Iterable[tuple[int, int, slice, slice]]) -> None:
    """Bend every arm, from its starting posture, until its hand is at its strut: Newton's way, by the least motion.

    Args:
        hands: of each arm the sites of the tool centre and of the grasp, and its joints in qpos and qvel.
    """
    for tcp, grasp, qpos, dof in hands:
        for _ in range(ROUNDS):
            locate(model, data)
            way = np.concatenate(
                [
                    data.site_xpos[grasp] - data.site_xpos[tcp],
                    turn_between(rotation(data, tcp), rotation(data, grasp)),
                ]
            )
            if np.abs(way).max() < REACHED:
                break
            data.qpos[qpos] += np.linalg.pinv(site_jacobian(model, data, tcp)[:, dof]) @ way


def turn_between(R_WA: Array, R_WB: Array) -> Array:
    """The small turn from A to B as a rotation vector in W, (3,) rad, by its sine."""
    R = R_WB @ R_WA.T
    return 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
