"""The paper's control law, assembled from its equations, with the paper's gains.

The printed gains are per degree (docs/control-law.md says why); here they stand in SI.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from agents.arm_model import ArmModel, ArmSnapshot
from agents.controllers.interface import Effort, Sensed
from agents.equations.law import base_force, joint_torque
from agents.equations.null_space import null_torque_projected
from agents.equations.stiffness import DEG, adaptive_stiffness, projected_error_rate, projected_joint_error
from agents.equations.task import (
    dynamically_consistent_inverse,
    external_torque,
    task_acceleration,
    task_drift,
    task_inertia,
    task_torque,
    task_velocity,
    tilt_error,
)
from agents.errors import ControllerError

Array = NDArray[np.float64]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]

TASK_ROWS = slice(2, 5)
"""Rows v_z, w_x, w_y of a hand Jacobian [v; w]."""


class PaperGains(BaseModel):
    """Gains of the paper's law, SI; the defaults are the printed ones. (Section V; control gains of Table I.)"""

    model_config = ConfigDict(extra="forbid", frozen=True)

    task_stiffness_1_s2: NotNegative = 80.0
    """K_e."""
    task_damping_1_s: NotNegative = 1.0
    """B_e."""
    null_stiffness_Nm_rad: tuple[NotNegative, ...] = (15 * DEG, *(5 * DEG,) * 6)
    """K_nu, printed as diag[15, 5, 5, 5, 5, 5, 5] N m/deg."""
    null_damping_Nms_rad: NotNegative = 0.4 * DEG
    """B_nu, printed as 0.4 N m s/deg; read as joint damping D carried over into the null space."""
    alpha: NotNegative = 0.02
    """Eq. 14: the step of the paper's platform."""
    beta: NotNegative = 100.0
    """Eq. 15, per degree as printed."""
    adaptive: bool = True
    """Eq. 15 on (K_var) or off (K_nu stays)."""
    drift_compensation: bool = True
    """The Jdot qd term that eq. 9 leaves out (ours)."""
    base_stiffness_N_m: NotNegative = 2000.0
    """K_m."""
    base_damping_Ns_m: NotNegative = 20.0
    """B_m."""


class PaperController:
    """Equations 5 to 16: holds the hand's height, roll and pitch where they were at the first step, follows in the
    plane, stiffens with the error, drives the base after the hand.

    Raises:
        pydantic.ValidationError: a gain is unknown or not a number in its range.
        ControllerError: the stiffness does not fit the arm's number of joints.
    """

    gains_model = PaperGains

    def __init__(self, arm: ArmModel, **gains: object) -> None:
        self._arm = arm
        self.gains = PaperGains.model_validate(gains)
        self._K_nu = np.array(self.gains.null_stiffness_Nm_rad)
        if self._K_nu.shape != (arm.joints,):
            raise ControllerError(
                f"controller paper: null_stiffness_Nm_rad: got {self._K_nu.size} numbers, expected {arm.joints}, one "
                f"per joint of arm model {arm.name}"
            )
        self._D = np.full(arm.joints, self.gains.null_damping_Nms_rad)
        self._K_e = np.full(3, self.gains.task_stiffness_1_s2)
        self._B_e = np.full(3, self.gains.task_damping_1_s)
        self._held: _Held | None = None

    def step(self, sensed: Sensed, dt_s: float) -> Effort:
        """The law remembers the pose at the first step and integrates nothing: ``dt_s`` is not used."""
        arm = self._arm.snapshot(sensed.q, sensed.qd)
        if self._held is None:
            self._held = _Held(arm)
        qd, gains = arm.qd, self.gains
        J, Jdot = arm.J[TASK_ROWS], arm.Jdot[TASK_ROWS]

        x_err = self._held.task_error(arm)
        xd_err = -task_velocity(J, qd)
        Lambda_x = task_inertia(J, arm.M_inv)
        Jbar = dynamically_consistent_inverse(J, arm.M_inv, Lambda_x)

        q_err = projected_joint_error(gains.alpha, Jbar, x_err)
        K = self._K_nu
        if gains.adaptive:
            K = adaptive_stiffness(K, gains.beta, q_err, projected_error_rate(gains.alpha, Jbar, xd_err))

        xdd_c = task_acceleration(np.zeros(3), xd_err, x_err, self._B_e, self._K_e)
        if gains.drift_compensation:
            xdd_c = xdd_c - task_drift(Jdot, qd)
        tau_task = task_torque(J, Lambda_x, xdd_c, Jbar, external_torque(K, Jbar, x_err))

        tau_null = null_torque_projected(J, Jdot, Jbar, Lambda_x, arm.C, self._D, qd, K, q_err)

        F_m = base_force(
            arm.p_BE[:2] - self._held.xy, arm.J[:2] @ qd, gains.base_stiffness_N_m, gains.base_damping_Ns_m
        )
        return Effort(
            torque=joint_torque(tau_task, tau_null, arm.C, qd, arm.g),
            base_force=np.array([F_m[0], F_m[1], 0.0]),
            stiffness=K,
        )


class _Held:
    """The pose of the hand at the first step: what the task holds, and where the base wants the hand."""

    def __init__(self, arm: ArmSnapshot) -> None:
        self.z = arm.p_BE[2]
        self.xy = arm.p_BE[:2]
        self.u_E = arm.R_BE.T @ np.array([0.0, 0.0, 1.0])
        """The hand's axis that was vertical, in the hand's frame E."""

    def task_error(self, arm: ArmSnapshot) -> Array:
        """x_d - x: height, roll, pitch, (3,) m, rad, rad, in B."""
        tilt = tilt_error(arm.R_BE @ self.u_E)
        return np.array([self.z - arm.p_BE[2], tilt[0], tilt[1]])
