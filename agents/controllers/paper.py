"""The paper's control law, assembled from its equations, with the paper's gains.

The printed gains are per degree (docs/control-law.md says why); here they stand in SI.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from agents.arm_model import ArmModel, Hand
from agents.controllers.interface import Effort, Sensed
from agents.controllers.reference import ReferenceGains, ReferenceTime
from agents.controllers.wrist_input import WristInput
from agents.equations.chain import Chain, chain_terms, inverse_of_inertia
from agents.equations.law import base_force, joint_torque
from agents.equations.null_space import null_projection, null_torque_projected
from agents.equations.stiffness import DEG, adaptive_stiffness, projected_error_rate, projected_joint_error
from agents.equations.task import (
    UPRIGHT,
    dynamically_consistent_inverse,
    external_torque,
    task_acceleration,
    task_drift,
    task_inertia,
    task_torque,
    task_velocity,
    tilt_error,
)
from agents.equations.wrist import planar_momentum, planar_spring, planar_wrist_force
from agents.equations.yaw import yaw_moment
from agents.errors import ControllerError
from agents.tracing import Traced

Array = NDArray[np.float64]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]

TASK_ROWS = slice(2, 5)
"""Rows v_z, w_x, w_y of a hand Jacobian [v; w]."""


AT_REST: Array = np.zeros(3)


class PaperGains(ReferenceGains):
    """Gains of the paper's law, SI; the defaults are the printed ones. (Section V; control gains of Table I.)"""

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
    observer: bool = True
    """Eq. 10 on (tau_e = K J# x_err) or off (zero)."""
    drift_compensation: bool = True
    """The Jdot qd term that eq. 9 leaves out (ours)."""
    base_stiffness_N_m: NotNegative = 2000.0
    """K_m."""
    base_damping_Ns_m: NotNegative = 20.0
    """B_m."""
    base_input: Literal["displacement", "wrench"] = "displacement"
    """Section IV-D: what drives the base, the hand's displacement or the force at the wrist."""
    environment_stiffness_N_m: Positive = 100.0
    """k_env of F_est = k_env dx. With ``displacement`` it cancels, and the hand is free in the plane; with ``wrench``
    the hand is on a planar spring of this stiffness."""
    wrench_filter_s: Positive = 0.05
    """``wrench``: time constant of the low-pass."""
    null_restoring: bool = True
    """The term Z^T K q_err of eq. 13 on or off. A constant task error makes it push sideways, as if somebody pulled."""
    yaw_stiffness_Nm_rad: NotNegative = 0.0
    yaw_damping_Nms_rad: NotNegative = 0.0
    """A spring of the hand's yaw against the base (ours; the paper leaves yaw free)."""


def paper_law(
    gains: PaperGains,
    *,
    qd: Array,
    M_inv: Array,
    C: Array,
    g: Array,
    J: Array,
    Jdot: Array,
    p_BE: Array,
    R_BE: Array,
    p_held: Array,
    up_E: Array,
    ahead_held: Array,
    up_d: Array = UPRIGHT,
    xd_d: Array = AT_REST,
    xdd_d: Array = AT_REST,
) -> tuple[Array, Array, Array]:
    """Joint torque (n,) N m, base force (3,) N, N, N m in B, and joint stiffness (n,) N m/rad. Equations 5 to 16.

    Args:
        qd: joint velocities, (n,) rad/s.
        M_inv, C, g, J, Jdot, p_BE, R_BE: as in :class:`agents.arm_model.ArmSnapshot`.
        p_held: where the hand was at the first step, (3,) m in B, with the desired height: the base keeps the rest.
        up_E: the hand's axis that was vertical then, (3,) unit vector in the hand's frame E.
        ahead_held: the hand's x axis then, (3,) unit vector in B.
        up_d: where that axis shall point, (3,) unit vector in B.
        xd_d, xdd_d: desired velocity and acceleration of the task (height, roll, pitch), (3,) m, rad per s, s^2.
    """
    J_x, Jdot_x = J[TASK_ROWS], Jdot[TASK_ROWS]
    K_nu = np.array(gains.null_stiffness_Nm_rad)
    D = np.full(len(K_nu), gains.null_damping_Nms_rad)
    K_e, B_e = np.full(3, gains.task_stiffness_1_s2), np.full(3, gains.task_damping_1_s)

    x_err = np.array([p_held[2] - p_BE[2], *tilt_error(R_BE @ up_E, up_d)])
    xd_err = xd_d - task_velocity(J_x, qd)
    Lambda_x = task_inertia(J_x, M_inv)
    Jbar = dynamically_consistent_inverse(J_x, M_inv, Lambda_x)

    q_err = projected_joint_error(gains.alpha, Jbar, x_err)
    K = K_nu
    if gains.adaptive:
        K = adaptive_stiffness(K_nu, gains.beta, q_err, projected_error_rate(gains.alpha, Jbar, xd_err))

    xdd_c = task_acceleration(xdd_d, xd_err, x_err, B_e, K_e)
    if gains.drift_compensation:
        xdd_c = xdd_c - task_drift(Jdot_x, qd)
    tau_e = external_torque(K, Jbar, x_err) if gains.observer else np.zeros(len(K_nu))
    tau_task = task_torque(J_x, Lambda_x, xdd_c, Jbar, tau_e)

    K_null = K if gains.null_restoring else np.zeros(len(K_nu))
    tau_null = null_torque_projected(J_x, Jdot_x, Jbar, Lambda_x, C, D, qd, K_null, q_err)

    if gains.yaw_stiffness_Nm_rad or gains.yaw_damping_Nms_rad:
        moment = yaw_moment(R_BE[:, 0], ahead_held, J[5] @ qd, gains.yaw_stiffness_Nm_rad, gains.yaw_damping_Nms_rad)
        tau_null = tau_null + null_projection(J_x, Jbar, J[5] * moment)

    if gains.base_input == "wrench":
        spring = planar_spring(p_BE[:2] - p_held[:2], gains.environment_stiffness_N_m)
        tau_null = tau_null + null_projection(J_x, Jbar, J[:2].T @ spring)

    F_m = base_force(p_BE[:2] - p_held[:2], J[:2] @ qd, gains.base_stiffness_N_m, gains.base_damping_Ns_m)
    return joint_torque(tau_task, tau_null, C, qd, g), np.array([*F_m, 0.0]), K


def law_of_the_arm(
    chain: Chain,
    gains: PaperGains,
    q: Array,
    qd: Array,
    p_held: Array,
    up_E: Array,
    ahead_held: Array,
    when: Array | None = None,
    wrist_force: Array | None = None,
    hand: Hand | None = None,
) -> tuple[Array, ...]:
    """:func:`paper_law` with the arm's terms worked out beside it, for joint positions q, (n,) rad; and the hand's pose
    p_BE, (3,), and R_BE, (9,).

    Args:
        when: time since take-over, s, and the share of the reference's ramp that is over, (2,), if there is one.
        wrist_force: as it is measured, (3,) N in the wrist's frame, if it drives the base.
        hand: what hangs on the wrist; then the planar force on it and its momentum, (4,), come before the hand's pose.
    """
    now = chain_terms(chain, q, qd)
    desired: dict[str, Array] = {}
    if when is not None:
        x_d, desired["xd_d"], desired["xdd_d"], desired["up_d"] = gains.desired(*when)
        p_held = np.array([p_held[0], p_held[1], p_held[2] + x_d[0]])
    torque, force, K = paper_law(
        gains, qd=qd, M_inv=inverse_of_inertia(now.M), C=now.C, g=now.g, J=now.J, Jdot=now.Jdot, p_BE=now.p_BE,
        R_BE=now.R_BE, p_held=p_held, up_E=up_E, ahead_held=ahead_held, **desired,
    )  # fmt: skip
    felt: list[Array] = []
    if wrist_force is not None and hand is not None:
        momentum = planar_momentum(hand.mass, now.J[:3] @ qd, now.J[3:] @ qd, now.R_BE @ hand.p_EC)
        felt = [np.concatenate([planar_wrist_force(wrist_force, now.R_BE @ hand.R_EW), momentum])]
    return torque, force, K, *felt, now.p_BE, now.R_BE.ravel()


STRAIGHT_DOWN = (0.0, 0.0, -1.0)
"""The vertical, seen from a hand that points straight down."""


class PaperController:
    """Equations 5 to 16: holds the hand's height, roll and pitch where they were at the first step (or where it is told
    to, ours), follows in the plane, stiffens with the error, drives the base after the hand.

    Runs :func:`law_of_the_arm` traced (agents/tracing.py): the same equations, and the arm's, as machine code.

    Raises:
        pydantic.ValidationError: a gain is unknown or not a number in its range.
        ControllerError: the stiffness does not fit the arm's number of joints.
    """

    gains_model: type[PaperGains] = PaperGains

    def __init__(self, arm: ArmModel, **gains: object) -> None:
        n = arm.joints
        self.gains = self.gains_model.model_validate(gains)
        if len(self.gains.null_stiffness_Nm_rad) != n:
            raise ControllerError(
                f"null_stiffness_Nm_rad: got {len(self.gains.null_stiffness_Nm_rad)} numbers, "
                f"expected {n}, one per joint of arm model {arm.name}"
            )
        shapes = {"q": (n,), "qd": (n,), "p_held": (3,), "up_E": (3,), "ahead_held": (3,)}
        self._along = ReferenceTime(self.gains) if self.gains.reference != "none" else None
        if self._along:
            shapes["when"] = ReferenceTime.shape
        self._by_force: WristInput | None = None
        law = partial(law_of_the_arm, arm.chain, self.gains)
        if self.gains.base_input == "wrench":
            shapes["wrist_force"] = (3,)
            law = partial(law, hand=arm.beyond_the_wrist())
            self._by_force = WristInput(self.gains.environment_stiffness_N_m, self.gains.wrench_filter_s)
        self._law = Traced(law, shapes)
        self._holds = False
        self._height_m: float | None = None

    def carry_at(self, height_m: float) -> None:
        """Hold this height, m in B, and the hand straight down, instead of what is found at the first step: so an arm
        that comes back, or joins, takes its share of a load that has sagged meanwhile."""
        self._height_m = height_m

    def step(self, sensed: Sensed, dt_s: float) -> Effort:
        """The law remembers the pose at the first step, and adds up ``dt_s`` to know where its reference is."""
        law = self._law
        inputs = law.inputs
        inputs["q"][:], inputs["qd"][:] = sensed.q, sensed.qd
        if not self._holds:
            law()
            self._hold()
        if self._along:
            self._along.write(inputs["when"], dt_s)
        if self._by_force is not None:
            inputs["wrist_force"][:] = sensed.wrench[:3]
        law()
        torque, drive, stiffness, *_ = law.outputs
        if self._by_force is not None:
            drive = self._driven_by_the_wrist(self._by_force, dt_s)
        return Effort(torque.copy(), drive.copy(), stiffness.copy())

    def _driven_by_the_wrist(self, wrist: WristInput, dt_s: float) -> Array:
        """Equation 16 with the displacement that the force stands for, (3,) N, N, N m in B."""
        felt, gains = self._law.outputs[3], self.gains
        e, e_rate = wrist.step(felt[:2], felt[2:], dt_s)
        return np.array([*base_force(e, e_rate, gains.base_stiffness_N_m, gains.base_damping_Ns_m), 0.0])

    def _hold(self) -> None:
        """Keep the pose of the hand as it is, or what was told of it."""
        inputs, (p_BE, R_BE) = self._law.inputs, self._law.outputs[-2:]
        inputs["p_held"][:], inputs["up_E"][:], inputs["ahead_held"][:] = p_BE, R_BE[6:], R_BE[::3]
        if self._height_m is not None:
            inputs["p_held"][2], inputs["up_E"][:] = self._height_m, STRAIGHT_DOWN
        self._holds = True
