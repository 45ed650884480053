"""The preset `palanquin`: springs of the hand, an observer that takes the load over, and bases that brake."""

from __future__ import annotations

from functools import partial
from math import exp
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from agents.arm_model import ArmModel
from agents.controllers.interface import Effort, Sensed
from agents.equations.bounds import limited
from agents.equations.chain import Chain, chain_terms, inverse_of_inertia
from agents.equations.impedance import damping, damping_power, spring_force, stiffening, stiffness_power
from agents.equations.law import base_force
from agents.equations.null_space import null_projection
from agents.equations.observer import leaky_observer, momentum_rate, observer_gain
from agents.equations.saturation import yield_moment
from agents.equations.task import dynamically_consistent_inverse, task_inertia, task_velocity, tilt_error
from agents.equations.yaw import yaw_moment
from agents.tracing import Traced
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]

TASK_ROWS = slice(2, 5)
"""Rows v_z, w_x, w_y of a hand Jacobian [v; w]."""
PLANE, YAW = slice(0, 2), 5
"""Rows v_x, v_y, and w_z."""
WRIST_JOINTS = 3
"""The last joints, which may yield."""


class PalanquinGains(BaseModel):
    """Gains of the law, SI. One set for all loads and teams."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    lift_stiffness_N_m: Positive = 8000.0
    tilt_stiffness_Nm_rad: Positive = 600.0
    stiffen: NotNegative = 1.0
    lift_soft_m: Positive = 0.005
    tilt_soft_rad: Positive = 0.02
    stiffness_rate_1_s: NotNegative = 10.0
    damping_ratio: NotNegative = 1.0
    observer_rate_1_s: NotNegative = 10.0
    observer_leak_1_s: Positive = 1.0
    plane_stiffness_N_m: NotNegative = 40.0
    plane_damping_Ns_m: NotNegative = 50.0
    yaw_stiffness_Nm_rad: NotNegative = 150.0
    yaw_damping_Nms_rad: NotNegative = 20.0
    posture_stiffness_Nm_rad: NotNegative = 20.0
    posture_damping_Nms_rad: NotNegative = 5.0
    base_stiffness_N_m: NotNegative = 2000.0
    base_damping_Ns_m: NotNegative = 20.0
    yaw_moment_max_Nm: Positive = 8.0
    base_yaw_hold: NotNegative = 1.0
    base_yaw_stiffness_Nm_rad: NotNegative = 6.0
    base_yaw_damping_Nms_rad: NotNegative = 0.0
    wrist_yields: bool = True


def palanquin_law(
    gains: PalanquinGains, tau_max: Array, chain: Chain, *, q: Array, qd: Array, tau: Array, p_held: Array,
    up_E: Array, ahead_held: Array, q_held: Array, p_before: Array, r: Array, K: Array, keep: Array, dt_s: Array,
    rise: Array,
) -> tuple[Array, ...]:
    now = chain_terms(chain, q, qd)
    M_inv = inverse_of_inertia(now.M)
    J, R_BE, p_BE = now.J, now.R_BE, now.p_BE
    J_x = J[TASK_ROWS]
    n = len(chain.links)

    Lambda = task_inertia(J, M_inv)
    Jbar = dynamically_consistent_inverse(J, M_inv, Lambda)
    Lambda_x = task_inertia(J_x, M_inv)

    x_err = np.array([p_held[2] - p_BE[2], *tilt_error(R_BE @ up_E)])
    xd = task_velocity(J_x, qd)

    p = now.M @ qd
    tau_ext = (p - p_before) / dt_s - momentum_rate(tau, now.C, qd, now.g)
    gain = observer_gain(gains.observer_rate_1_s, gains.observer_leak_1_s)
    r = leaky_observer(r, tau_ext, gain, keep)
    F_x = (Jbar.T @ r)[TASK_ROWS]

    K_least = np.array([gains.lift_stiffness_N_m, gains.tilt_stiffness_Nm_rad, gains.tilt_stiffness_Nm_rad])
    soft = np.array([gains.lift_soft_m, gains.tilt_soft_rad, gains.tilt_soft_rad])
    wanted = stiffening(K_least, (1.0 + gains.stiffen) * K_least, x_err, soft)
    K_next = limited(wanted, K / rise, K * rise)
    D = damping(K_next, Lambda_x, gains.damping_ratio)
    F = spring_force(K_next, x_err, D, xd) - F_x

    e = p_BE[PLANE] - p_held[PLANE]
    e_rate = J[PLANE] @ qd
    F_plane = -gains.plane_stiffness_N_m * e - gains.plane_damping_Ns_m * e_rate
    moment = yaw_moment(R_BE[:, 0], ahead_held, J[YAW] @ qd, gains.yaw_stiffness_Nm_rad, gains.yaw_damping_Nms_rad)
    moment = limited(moment, -gains.yaw_moment_max_Nm, gains.yaw_moment_max_Nm)
    posture = gains.posture_stiffness_Nm_rad * (q_held - q) - gains.posture_damping_Nms_rad * qd
    torque = (
        J_x.T @ F + J[PLANE].T @ F_plane + J[YAW] * moment + null_projection(J, Jbar, posture) + now.C @ qd + now.g
    )
    if gains.wrist_yields:
        torque = yield_moment(torque, J[3:], tau_max, range(n - WRIST_JOINTS, n))
    turned = R_BE[1, 0] * ahead_held[0] - R_BE[0, 0] * ahead_held[1]
    F_m = base_force(e, e_rate, gains.base_stiffness_N_m, gains.base_damping_Ns_m)
    reaction = p_BE[0] * F_plane[1] - p_BE[1] * F_plane[0] + moment
    T_m = reaction * gains.base_yaw_hold + gains.base_yaw_stiffness_Nm_rad * turned + gains.base_yaw_damping_Nms_rad * (J[YAW] @ qd)
    residual = stiffness_power((K_next - K) / dt_s, x_err) - damping_power(D, xd) - F_x @ xd
    stiffness = np.diag(J_x.T @ (K_next[:, None] * J_x))
    return torque, np.array([*F_m, T_m]), stiffness, p, r, K_next, np.array([residual]), p_BE, R_BE.ravel()


class PalanquinController:
    gains_model = PalanquinGains

    def __init__(self, arm: ArmModel, **gains: object) -> None:
        n = arm.joints
        self.gains = PalanquinGains.model_validate(gains)
        shapes = {
            "q": (n,), "qd": (n,), "tau": (n,), "p_held": (3,), "up_E": (3,), "ahead_held": (3,), "q_held": (n,),
            "p_before": (n,), "r": (n,), "K": (3,), "keep": (1,), "dt_s": (1,), "rise": (1,),
        }
        self._law = Traced(partial(palanquin_law, self.gains, np.array(arm_limits(arm.name).torque_Nm), arm.chain), shapes)
        self._holds = False
        self._height_m: float | None = None

    def carry_at(self, height_m: float) -> None:
        self._height_m = height_m

    def step(self, sensed: Sensed, dt_s: float) -> Effort:
        law = self._law
        inputs = law.inputs
        inputs["q"][:], inputs["qd"][:], inputs["tau"][:] = sensed.q, sensed.qd, sensed.tau
        inputs["dt_s"][0] = dt_s
        if not self._holds:
            inputs["keep"][0], inputs["rise"][0] = 0.0, 1.0
            g = self.gains
            inputs["K"][:] = g.lift_stiffness_N_m, g.tilt_stiffness_Nm_rad, g.tilt_stiffness_Nm_rad
            law()
            self._hold(sensed.q)
            inputs["p_before"][:] = law.outputs[3]
            law()
        else:
            g = self.gains
            inputs["keep"][0] = exp(-(g.observer_rate_1_s + g.observer_leak_1_s) * dt_s)
            inputs["rise"][0] = exp(g.stiffness_rate_1_s * dt_s)
            law()
        torque, base_force, stiffness, p, r, K, residual, *_ = law.outputs
        inputs["p_before"][:], inputs["r"][:], inputs["K"][:] = p, r, K
        return Effort(torque.copy(), base_force.copy(), stiffness.copy())

    def _hold(self, q: Array) -> None:
        inputs, (p_BE, R_BE) = self._law.inputs, self._law.outputs[-2:]
        inputs["p_held"][:], inputs["up_E"][:], inputs["ahead_held"][:] = p_BE, R_BE[6:], R_BE[::3]
        inputs["q_held"][:] = q
        if self._height_m is not None:
            inputs["p_held"][2], inputs["up_E"][:] = self._height_m, (0.0, 0.0, -1.0)
        self._holds = True
