"""One Panda for tests: its model, what it senses, and a simulated one on a fixed base."""

from __future__ import annotations

from functools import cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.controllers.interface import Effort, Sensed
from agents.safety import CheckedEffort
from wire.arms import arm_path

Array = NDArray[np.float64]

HOME = np.array([0.0, -0.1, 0.0, -2.1, 0.0, 2.0, np.pi / 4])
"""The hand points straight down, half a metre before the base."""


@cache
def arm() -> ArmModel:
    return ArmModel("panda")


def sensed(q: Array, qd: Array | None = None, tau: Array | None = None) -> Sensed:
    zero = np.zeros(7)
    return Sensed(q, zero if qd is None else qd, zero if tau is None else tau, np.zeros(6))


class OneArm:
    """A simulated Panda on a fixed base, 1 ms steps, with a point mass at the tool centre that no agent knows of."""

    def __init__(self, mass_kg: float = 0.0) -> None:
        xml = arm_path("panda").read_text(encoding="utf-8")
        tcp = '<site name="tcp" pos="0 0 0.1034"/>'
        assert xml.count(tcp) == 1
        if mass_kg:
            load = f'<inertial pos="0 0 0" mass="{mass_kg}" diaginertia="1e-6 1e-6 1e-6"/>'
            xml = xml.replace(tcp, f'{tcp}<body pos="0 0 0.1034">{load}</body>')
        self.model: Any = mujoco.MjModel.from_xml_string(xml)
        self.model.opt.timestep = 1e-3
        self.data: Any = mujoco.MjData(self.model)
        self.data.qpos[:] = HOME
        mujoco.mj_forward(self.model, self.data)

    def sense(self) -> Sensed:
        data = self.data
        return Sensed(data.qpos.copy(), data.qvel.copy(), data.qfrc_applied.copy(), np.zeros(6))

    def apply(self, effort: Effort | CheckedEffort) -> None:
        self.data.qfrc_applied[:] = effort.torque
        mujoco.mj_step(self.model, self.data)

    @property
    def height(self) -> float:
        return float(self.data.site("tcp").xpos[2])

    @property
    def tilt(self) -> float:
        """Angle between the hand's axis and straight down, rad; by its sine, which is exact near zero."""
        x, y, _ = self.data.site("tcp").xmat.reshape(3, 3)[:, 2]
        return float(np.arcsin(np.hypot(x, y)))
