"""The preset `palanquin`: hands on springs, an observer that takes the load over, bases that brake. (Ours.)

The paper's signals and the paper's silence: own joints, own torques, own wrist. docs/control-law.md says what each part
is for.
"""

from __future__ import annotations

from functools import partial
from math import exp

import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.controllers.interface import Effort, Sensed
from agents.controllers.palanquin_gains import PalanquinGains
from agents.controllers.reference import ReferenceTime
from agents.equations.bounds import limited
from agents.equations.chain import Chain, chain_terms, inverse_of_inertia
from agents.equations.impedance import (
    damping,
    damping_power,
    spring_force,
    stiffening,
    stiffness_power,
    stiffness_step,
)
from agents.equations.law import base_force
from agents.equations.null_space import null_projection
from agents.equations.observer import felt_torque, leaky, momentum_rate
from agents.equations.saturation import yield_moment
from agents.equations.task import (
    UPRIGHT,
    dynamically_consistent_inverse,
    task_inertia,
    task_velocity,
    tilt_error,
)
from agents.equations.yaw import reaction_moment, yaw_moment, yaw_sine
from agents.tracing import Traced
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]

TASK_ROWS, PLANE_ROWS, YAW_ROW = slice(2, 5), slice(0, 2), 5
"""Rows of a hand Jacobian [v; w]: v_z, w_x, w_y; v_x, v_y; w_z."""
WRIST_JOINTS = 3
"""The last joints, which may yield."""
AT_REST = np.zeros(3)
STRAIGHT_DOWN = (0.0, 0.0, -1.0)
"""The vertical, seen from a hand that points straight down."""


def palanquin_law(
    gains: PalanquinGains,
    chain: Chain,
    tau_max: Array,
    *,
    q: Array,
    qd: Array,
    tau: Array,
    wrench: Array,
    p_held: Array,
    up_E: Array,
    ahead_held: Array,
    q_held: Array,
    p: Array,
    r: Array,
    f: Array,
    K: Array,
    dt_s: Array,
    keep_r: Array,
    keep_f: Array,
    rise: Array,
    when: Array | None = None,
) -> tuple[Array, ...]:
    """Torque (n,) N m, base force (3,) N, N, N m in B, joint stiffness (n,) N m/rad; the memory p, r, f, K for the next
    step; passivity residual (1,) W; and the hand's pose p_BE (3,), R_BE (9,).

    Args:
        tau_max: (n,) N m.
        q, qd, tau, wrench: as in :class:`agents.controllers.interface.Sensed`.
        p_held: where the hand was at the first step, (3,) m in B: its height is held, the base keeps the rest.
        up_E: the hand's axis that was vertical then, (3,) unit vector in the hand's frame E.
        ahead_held: the hand's x axis then, (3,) unit vector in B.
        q_held: the joints then, (n,) rad.
        p: generalised momentum at the step before, (n,) N m s.
        r: observed external torque, (n,) N m.
        f: correction of the hand's force in the plane, (2,) N in B.
        K: task stiffness, (3,) N/m, N m/rad, N m/rad.
        dt_s, keep_r, keep_f, rise: (1,) each: since the step before, and what :func:`observer.leaky` and
            :func:`impedance.stiffness_step` make of it.
        when: time since take-over, s, and the share of the reference's ramp that is over, (2,), if there is one.
    """
    x_d, xd_d, xdd_d, up_d = (AT_REST, AT_REST, AT_REST, UPRIGHT) if when is None else gains.desired(*when)
    now = chain_terms(chain, q, qd)
    M_inv, J, J_x, n = inverse_of_inertia(now.M), now.J, now.J[TASK_ROWS], len(chain.links)
    Jbar = dynamically_consistent_inverse(J, M_inv, task_inertia(J, M_inv))  # of all six: tells lift from push

    # Height, roll, pitch: a spring that stiffens, a damper that goes with it, and what the observer feels taken over.
    x_err = np.array([p_held[2] + x_d[0] - now.p_BE[2], *tilt_error(now.R_BE @ up_E, up_d)])
    xd = task_velocity(J_x, qd) - xd_d  # against the reference
    p_before, p = p, now.M @ qd
    tau_ext = felt_torque(p, p_before, momentum_rate(tau, now.C, qd, now.g), dt_s)
    r = leaky(r, tau_ext, gains.observer_rate_1_s / (gains.observer_rate_1_s + gains.observer_leak_1_s), keep_r)
    F_felt = (Jbar.T @ r)[TASK_ROWS]

    K_least = least_stiffness(gains)
    soft = np.array([gains.lift_soft_m, gains.tilt_soft_rad, gains.tilt_soft_rad])
    wanted = stiffening(K_least, (1.0 + gains.stiffen) * K_least, x_err, soft)
    K_before, K = K, stiffness_step(K, wanted, rise) if gains.stiffness_rate_1_s else wanted
    Lambda_x = task_inertia(J_x, M_inv)
    D = damping(K, Lambda_x, gains.damping_ratio)
    F_task = spring_force(K, x_err, D, xd) + Lambda_x @ xdd_d - F_felt

    # The plane: a soft spring to a base that follows late, and a hand that weighs no more than it is told to.
    e, e_rate = now.p_BE[PLANE_ROWS] - p_held[PLANE_ROWS], J[PLANE_ROWS] @ qd
    F_wanted = -gains.plane_stiffness_N_m * e - gains.plane_damping_Ns_m * e_rate
    f = leaky(f, F_wanted - (now.R_BE @ wrench[:3])[PLANE_ROWS], gains.force_rate_1_s / gains.force_leak_1_s, keep_f)
    F_plane = F_wanted + f

    # Yaw, and the elbow, which alone is left.
    k, b, most = gains.yaw_stiffness_Nm_rad, gains.yaw_damping_Nms_rad, gains.yaw_moment_max_Nm
    moment = limited(yaw_moment(now.R_BE[:, 0], ahead_held, J[YAW_ROW] @ qd, k, b), -most, most)
    posture = gains.posture_stiffness_Nm_rad * (q_held - q) - gains.posture_damping_Nms_rad * qd

    torque = J_x.T @ F_task + J[PLANE_ROWS].T @ F_plane + J[YAW_ROW] * moment + null_projection(J, Jbar, posture)
    torque = torque + now.C @ qd + now.g
    if gains.wrist_yields:
        torque = yield_moment(torque, J[3:], tau_max, range(n - WRIST_JOINTS, n))

    turn = gains.base_yaw_stiffness_Nm_rad * yaw_sine(ahead_held, now.R_BE[:, 0])
    if gains.base_yaw_hold:
        turn = turn + reaction_moment(now.p_BE, F_wanted, moment)
    follow = base_force(e, e_rate, gains.base_stiffness_N_m, gains.base_damping_Ns_m)

    residual = stiffness_power((K - K_before) / dt_s, x_err) - F_felt @ xd + f @ e_rate - damping_power(D, xd)
    stiffness = np.diag(J_x.T @ (K[:, None] * J_x))
    return torque, np.array([*follow, turn]), stiffness, p, r, f, K, np.array([residual]), now.p_BE, now.R_BE.ravel()


def least_stiffness(gains: PalanquinGains) -> Array:
    """Task stiffness without an error, (3,) N/m, N m/rad, N m/rad."""
    return np.array([gains.lift_stiffness_N_m, gains.tilt_stiffness_Nm_rad, gains.tilt_stiffness_Nm_rad])


class PalanquinController:
    """Holds the hand's height, roll and pitch where they were at the first step (or where it is told to), lets it go
    in the plane with a light brake, drives the base after it.

    At its first step the observer takes what the arm bears at that moment for the load, as if at rest.

    Its passivity residual (:class:`agents.controllers.interface.Effort`) is that of the directions that have a memory,
    against the reference if there is one. At most 0 where the law is passive; the observer's and the force correction's
    parts have either sign.

    Raises:
        pydantic.ValidationError: a gain is unknown or not a number in its range.
    """

    gains_model = PalanquinGains

    def __init__(self, arm: ArmModel, **gains: object) -> None:
        n = arm.joints
        self.gains = self.gains_model.model_validate(gains)
        shapes = {"q": (n,), "qd": (n,), "tau": (n,), "wrench": (6,)}
        shapes |= {"p_held": (3,), "up_E": (3,), "ahead_held": (3,), "q_held": (n,)}
        shapes |= {"p": (n,), "r": (n,), "f": (2,), "K": (3,)}
        shapes |= {"dt_s": (1,), "keep_r": (1,), "keep_f": (1,), "rise": (1,)}
        self._along = ReferenceTime(self.gains) if self.gains.reference != "none" else None
        if self._along:
            shapes["when"] = ReferenceTime.shape
        law = partial(palanquin_law, self.gains, arm.chain, np.array(arm_limits(arm.name).torque_Nm))
        self._law = Traced(law, shapes)
        self._holds = False
        self._height_m: float | None = None

    def carry_at(self, height_m: float) -> None:
        """Hold this height, m in B, and the hand straight down, instead of what is found at the first step."""
        self._height_m = height_m

    def step(self, sensed: Sensed, dt_s: float) -> Effort:
        """The effort at this instant."""
        law, gains = self._law, self.gains
        inputs = law.inputs
        inputs["q"][:], inputs["qd"][:] = sensed.q, sensed.qd
        inputs["tau"][:], inputs["wrench"][:], inputs["dt_s"][0] = sensed.tau, sensed.wrench, dt_s
        if self._along:
            self._along.write(inputs["when"], dt_s)
        if self._holds:
            inputs["keep_r"][0] = exp(-(gains.observer_rate_1_s + gains.observer_leak_1_s) * dt_s)
            inputs["keep_f"][0] = exp(-gains.force_leak_1_s * dt_s)
            inputs["rise"][0] = exp(gains.stiffness_rate_1_s * dt_s)
        else:
            self._begin(sensed)
        law()
        torque, base_force, stiffness, p, r, f, K, residual, *_ = law.outputs
        inputs["p"][:], inputs["r"][:], inputs["f"][:], inputs["K"][:] = p, r, f, K
        return Effort(torque.copy(), base_force.copy(), stiffness.copy(), float(residual[0]))

    def _begin(self, sensed: Sensed) -> None:
        """Keep the pose of the hand as it is, or what was told of it; and a memory that this step fills: the observer
        forgets all (``keep_r`` 0), momentum and stiffness stand still, and there is no correction of forces."""
        law, inputs = self._law, self._law.inputs
        inputs["K"][:], inputs["rise"][0] = least_stiffness(self.gains), 1.0
        inputs["keep_r"][0], inputs["keep_f"][0] = 0.0, 1.0
        law()
        p, (p_BE, R_BE) = law.outputs[3], law.outputs[-2:]
        inputs["p"][:], inputs["q_held"][:] = p, sensed.q
        inputs["p_held"][:], inputs["up_E"][:], inputs["ahead_held"][:] = p_BE, R_BE[6:], R_BE[::3]
        if self._height_m is not None:
            inputs["p_held"][2], inputs["up_E"][:] = self._height_m, STRAIGHT_DOWN
        self._holds = True
