"""The paper's law with what it lacks when a bearer is lost: it pushes nobody sideways, and yaw does not drift."""

from __future__ import annotations

import numpy as np

from agents.arm_model import ArmModel
from agents.controllers.interface import Effort, Sensed
from agents.controllers.paper import NotNegative, PaperController, PaperGains
from agents.equations.saturation import yield_moment
from wire.arms.limits import arm_limits

WRIST_JOINTS = 3
"""The last joints, which may yield."""


class BetterGains(PaperGains):
    """The paper's gains, without its restoring term in the null space and with a spring on the hand's yaw.

    When a bearer is lost the others sag unevenly for good. The restoring term turns that into a planar force; so does
    a wrist at its torque limit. The leader balances the force at the point that it pulls, and the pair turns the load.
    """

    null_restoring: bool = False
    yaw_stiffness_Nm_rad: NotNegative = 60.0
    yaw_damping_Nms_rad: NotNegative = 10.0


class BetterController(PaperController):
    """:class:`agents.controllers.paper.PaperController` with :class:`BetterGains`, whose wrist yields at its limits."""

    gains_model = BetterGains

    def __init__(self, arm: ArmModel, **gains: object) -> None:
        super().__init__(arm, **gains)
        self._torque_max = np.array(arm_limits(arm.name).torque_Nm)
        self._wrist = range(arm.joints - WRIST_JOINTS, arm.joints)

    def step(self, sensed: Sensed, dt_s: float) -> Effort:
        effort = super().step(sensed, dt_s)
        J_w = self._law.outputs[3].reshape(3, -1)
        torque = yield_moment(effort.torque, J_w, self._torque_max, self._wrist)
        return Effort(torque, effort.base_force, effort.stiffness)
