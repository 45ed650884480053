"""How an arm differs from what its agent believes: drawn from the scenario's seed, the same on every run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_server.layout import Array
from sim_server.scenario import Plant

JOINTS = 7
STREAM = 2
"""Keeps these draws apart from other streams of the same seed: the plant's sensor noise is stream 1."""


@dataclass(frozen=True, eq=False)
class ArmDifferences:
    """One arm's differences.

    Attributes:
        link_scale: factors on mass and inertia, (8,): link1 to link7, then the hand with its fingers. The centre of
            mass stays. link0 stands on the base and is left alone.
        joint_damping: viscous friction, (7,) [N m s/rad].
        joint_friction: dry friction, (7,) [N m].
    """

    link_scale: Array
    joint_damping: Array
    joint_friction: Array


def draw_differences(plant: Plant, seed: int, arm_index: int) -> ArmDifferences:
    """Differences of arm number ``arm_index`` (0 first). Depends on nothing else: not on the team's size or order.

    Every draw is made whatever the settings, so switching one difference off leaves the others as they were.
    """
    rng = np.random.default_rng([seed, STREAM, arm_index])
    plant = plant.scaled
    links = rng.uniform(-1, 1, JOINTS + 1)
    damping, friction = rng.uniform(0.5, 1.5, (2, JOINTS))
    return ArmDifferences(
        link_scale=1.0 + plant.link_mass_error * links,
        joint_damping=plant.joint_damping_Nms_rad * damping,
        joint_friction=plant.joint_friction_Nm * friction,
    )
