"""The paper's equations: solved by hand for a two-link arm, and as laws of mechanics on the real arm model."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from agents.arm_model import ArmModel, ArmSnapshot
from agents.equations import law as law_equations
from agents.equations import null_space as null_equations
from agents.equations import saturation as saturation_equations
from agents.equations import stiffness as stiffness_equations
from agents.equations import task as task_equations
from agents.equations import yaw as yaw_equations
from agents.equations.law import base_force, joint_torque
from agents.equations.null_space import (
    null_acceleration,
    null_basis_continued,
    null_basis_orthonormal,
    null_basis_partition,
    null_basis_rate,
    null_coriolis,
    null_damping,
    null_inertia,
    null_inverse,
    null_inverse_rate,
    null_torque,
    null_torque_projected,
    null_velocity,
)
from agents.equations.stiffness import (
    adaptive_stiffness,
    adaptive_stiffness_deg,
    projected_error_rate,
    projected_joint_error,
)
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
from wire.arms import arm_path

Array = NDArray[np.float64]

EXACT = 1e-14
"""For sums by hand with numbers up to 100: one or two roundings."""
ALGEBRA = 1e-9
"""Relative: rounding of 2e-16, times the conditions of J M^-1 J^T (below 500 here) and of J_m (below 30), and some."""
H = 1e-5
"""Step of a central difference: cutting off costs H^2 = 1e-10 of the third derivative, rounding 2e-16 / H = 2e-11."""
DIFFERENCE = 1e-6
"""Relative, for differences with H of what holds J# or J_m^-1: the third derivative grows with 1 / sigma^3, and their
smallest singular values sigma go down to 0.1 and 0.05."""


def close(got: Array, expected: Array, relative: float) -> None:
    """Equal to ``relative`` of the largest number (at least 1) of what was expected."""
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(got, expected, rtol=0, atol=relative * scale)


def inverse(A: Array) -> Array:
    return cast(Array, np.linalg.inv(A))


# Solved by hand: two links of 1 m with point masses of 1 kg at their ends, q = (0, 90 deg), so that the elbow is at
# (1, 0) and the tip at (1, 1); qd = (1, 2). The task is the tip's height y = sin q1 + sin(q1 + q2).
#   M = [m1 + m2 (2 + 2 cos q2), m2 (1 + cos q2); m2 (1 + cos q2), m2] = [3, 1; 1, 1], M^-1 = [1, -1; -1, 3] / 2
#   C = sin q2 [-qd2, -(qd1 + qd2); qd1, 0] = [-2, -3; 1, 0], Mdot = C + C^T = [-4, -2; -2, 0]
#   J = [cos q1 + cos(q1 + q2), cos(q1 + q2)] = [1, 0], Jdot = -(qd1 + qd2) [1, 1] = [-3, -3]
M2 = np.array([[3.0, 1.0], [1.0, 1.0]])
M2_INV = np.array([[0.5, -0.5], [-0.5, 1.5]])
C2 = np.array([[-2.0, -3.0], [1.0, 0.0]])
MDOT2 = np.array([[-4.0, -2.0], [-2.0, 0.0]])
J2, JDOT2 = np.array([[1.0, 0.0]]), np.array([[-3.0, -3.0]])
QD2 = np.array([1.0, 2.0])
JBAR2 = np.array([[1.0], [-1.0]])
K2 = np.array([10.0, 20.0])


def test_task_of_the_two_link_arm() -> None:
    # Eq. 7: only the first joint lifts the tip, by 1 m per rad.
    np.testing.assert_allclose(task_velocity(J2, QD2), [1.0], atol=EXACT)
    # The second link hangs on its end and turns at 3 rad/s: 9 m/s^2 towards the elbow, downwards.
    np.testing.assert_allclose(task_drift(JDOT2, QD2), [-9.0], atol=EXACT)
    # J M^-1 J^T = 1/2: a vertical push feels both masses.
    np.testing.assert_allclose(task_inertia(J2, M2_INV), [[2.0]], atol=EXACT)
    # Eq. 8: M^-1 J^T Lambda_x = (1/2, -1/2) 2. The second link keeps its direction while the first one lifts.
    np.testing.assert_allclose(dynamically_consistent_inverse(J2, M2_INV, np.array([[2.0]])), JBAR2, atol=EXACT)
    # Eq. 6: 0.5 + 1 (0 - 1) + 80 0.1.
    xdd_c = task_acceleration(np.array([0.5]), np.array([-1.0]), np.array([0.1]), np.array([1.0]), np.array([80.0]))
    np.testing.assert_allclose(xdd_c, [7.5], atol=EXACT)
    # Eq. 10: (10 0.1, 20 (-0.1)).
    tau_e = external_torque(K2, JBAR2, np.array([0.1]))
    np.testing.assert_allclose(tau_e, [1.0, -2.0], atol=EXACT)
    # Eq. 9: J^T (2 7.5 + 1 + 2).
    np.testing.assert_allclose(task_torque(J2, np.array([[2.0]]), xdd_c, JBAR2, tau_e), [18.0, 0.0], atol=1e2 * EXACT)


def test_task_of_the_straight_two_link_arm() -> None:
    """q2 = 0: M = [5, 2; 2, 1], M^-1 = [1, -2; -2, 5], J = [2, 1]. A push at the tip feels the tip's mass alone, and
    the tip is lifted by the second joint alone: the first link carries nothing across itself."""
    J, M_inv = np.array([[2.0, 1.0]]), np.array([[1.0, -2.0], [-2.0, 5.0]])
    np.testing.assert_allclose(task_inertia(J, M_inv), [[1.0]], atol=EXACT)
    np.testing.assert_allclose(dynamically_consistent_inverse(J, M_inv, np.eye(1)), [[0.0], [1.0]], atol=EXACT)
    Z = null_basis_partition(J, [1])
    np.testing.assert_allclose(Z, [[1.0], [-2.0]], atol=EXACT)
    M = np.array([[5.0, 2.0], [2.0, 1.0]])
    np.testing.assert_allclose(null_inertia(Z, M), [[1.0]], atol=EXACT)  # the elbow's mass alone
    np.testing.assert_allclose(null_inverse(Z, M, np.eye(1)), [[1.0, 0.0]], atol=EXACT)


@pytest.mark.parametrize(
    ("Zdot", "Zbar_dot", "mu_nu", "nud_c"),
    [
        # At rest in the metric of M: Zdot = -J# Jdot Z = (1, -1) 3.
        #   d(Z^T M) = Zdot^T M + Z^T Mdot = (6, 0) + (-2, 0); Lambda_nu_dot = 0 + Z^T M Zdot = 0
        #   mu_nu = (1, 0) Z - (4, 0) Z = 0; nud_c = -((0 + 2) 3 - 4)
        ([[3.0], [-3.0]], [[4.0, 0.0]], 0.0, -2.0),
        # Of the partition Z = [-J2 / J1; 1]: Zdot = -Jdot2 / J1 = 3 in the first row.
        #   d(Z^T M) = (9, 3) + (-2, 0); Lambda_nu_dot = 3 + 3; Z#dot = (7, 3) - 6 (1, 1)
        #   mu_nu = (1, 0) Z - (1, -3) Z = 3 = Lambda_nu_dot / 2; nud_c = -((3 + 2) 3 - 4)
        ([[3.0], [0.0]], [[1.0, -3.0]], 3.0, -11.0),
    ],
    ids=["at_rest", "partition"],
)
def test_null_space_of_the_two_link_arm(
    Zdot: list[list[float]], Zbar_dot: list[list[float]], mu_nu: float, nud_c: float
) -> None:
    Z = null_basis_partition(J2, [0])
    np.testing.assert_allclose(Z, [[0.0], [1.0]], atol=EXACT)
    np.testing.assert_allclose(null_inertia(Z, M2), [[1.0]], atol=EXACT)
    Zbar = null_inverse(Z, M2, np.eye(1))  # Z^T M / 1
    np.testing.assert_allclose(Zbar, [[1.0, 1.0]], atol=EXACT)
    nu = null_velocity(Zbar, QD2)
    np.testing.assert_allclose(nu, [3.0], atol=EXACT)

    rate = null_inverse_rate(Z, np.array(Zdot), Zbar, M2, MDOT2, np.eye(1))
    np.testing.assert_allclose(rate, Zbar_dot, atol=EXACT)
    mu = null_coriolis(Z, C2, np.eye(1), rate)
    np.testing.assert_allclose(mu, [[mu_nu]], atol=EXACT)
    B_nu = null_damping(Z, np.array([5.0, 2.0]))
    np.testing.assert_allclose(B_nu, [[2.0]], atol=EXACT)
    # Z^T K q_err = 20 0.2 = 4. Eq. 11 depends on how the basis moves; eq. 13 does not:
    # Lambda_nu Z#dot qd + (mu_nu + B_nu) nu - 4 = 4 + 6 - 4, and -5 + 15 - 4, are both 6.
    q_err = np.array([0.1, 0.2])
    np.testing.assert_allclose(null_acceleration(np.eye(1), mu, B_nu, nu, Z, K2, q_err), [nud_c], atol=1e1 * EXACT)
    tau_null = null_torque(Zbar, np.eye(1), rate, QD2, mu, B_nu, nu, Z, K2, q_err)
    np.testing.assert_allclose(tau_null, [-6.0, -6.0], atol=1e1 * EXACT)


def test_basis_rate_of_the_two_link_arm() -> None:
    np.testing.assert_allclose(null_basis_rate(JBAR2, JDOT2, np.array([[0.0], [1.0]])), [[3.0], [-3.0]], atol=EXACT)


def test_torque_of_the_two_link_arm() -> None:
    # Eq. 5 with g = 10 m/s^2: (18, 0) + (-6, -6) + C qd = (-8, 1) + both masses at x = 1: (20, 0).
    tau = joint_torque(np.array([18.0, 0.0]), np.array([-6.0, -6.0]), C2, QD2, np.array([20.0, 0.0]))
    np.testing.assert_allclose(tau, [24.0, -5.0], atol=EXACT)


def test_observer_of_the_two_link_arm() -> None:
    # Eq. 14, and its rate.
    np.testing.assert_allclose(projected_joint_error(0.02, JBAR2, np.array([0.1])), [0.002, -0.002], atol=EXACT)
    np.testing.assert_allclose(projected_error_rate(0.02, JBAR2, np.array([-1.0])), [-0.02, 0.02], atol=EXACT)


@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_adaptive_stiffness_by_hand(rate: float) -> None:
    """Eq. 15: 5 + (100 0.1 / (1 + 1))^2 = 30 N m/deg; at the rate -1, where the printed denominator vanishes, too."""
    K = adaptive_stiffness_deg(np.array([5.0]), 100.0, np.array([0.1]), np.array([rate]))
    np.testing.assert_allclose(K, [30.0], atol=1e1 * EXACT)


def test_base_force_by_hand() -> None:
    """Eq. 16: 2000 (0.01, -0.02) + 20 (0.5, 1). The hand is ahead: the base is driven forward, after it."""
    F = base_force(np.array([0.01, -0.02]), np.array([0.5, 1.0]), 2000.0, 20.0)
    np.testing.assert_allclose(F, [30.0, -20.0], atol=EXACT)


PAGE = Path(__file__).resolve().parent.parent / "docs" / "control-law.md"


def test_the_page_on_the_law_names_every_equation_and_no_other() -> None:
    named = set(
        re.findall(
            r"`(\w+)`", re.sub(r"^(?!\| ).*$", "", PAGE.read_text(encoding="utf-8").split("## Gains")[0], flags=re.M)
        )
    )
    written = {
        name
        for module in (
            law_equations,
            null_equations,
            saturation_equations,
            stiffness_equations,
            task_equations,
            yaw_equations,
        )
        for name, function in vars(module).items()
        if getattr(function, "__module__", None) == module.__name__ and not name.startswith("_")
    }
    assert named == written


# The real arm.


@dataclass(frozen=True)
class Terms:
    """The task's terms at one state."""

    arm: ArmSnapshot
    J: Array
    Jdot: Array
    Lambda_x: Array
    Jbar: Array


@cache
def model() -> ArmModel:
    return ArmModel("panda")


def terms(q: Array, qd: Array) -> Terms:
    arm = model().snapshot(q, qd)
    J = arm.J[2:5]
    Lambda_x = task_inertia(J, arm.M_inv)
    return Terms(arm, J, arm.Jdot[2:5], Lambda_x, dynamically_consistent_inverse(J, arm.M_inv, Lambda_x))


PIVOTS = ((1, 2, 5), (1, 3, 5), (1, 4, 5), (1, 5, 6))
"""Joints 2 to 7 by number from 0; the first joint is vertical and moves no task direction."""


def usable(J: Array) -> bool:
    """Away from postures in which the task, or a partition of it, is lost: there the numbers grow without bound."""
    task, *parts = (np.linalg.svd(part, compute_uv=False)[-1] for part in (J, *(J[:, list(p)] for p in PIVOTS)))
    return bool(task > 0.1 and min(parts) > 0.05)


def random_states(count: int) -> list[Terms]:
    """States within the joint limits, speeds up to the joints' limits (about 2 rad/s)."""
    mj = mujoco_model()
    rng = np.random.default_rng(30)
    found: list[Terms] = []
    while len(found) < count:
        state = terms(rng.uniform(*mj.jnt_range.T), rng.uniform(-2.0, 2.0, 7))
        if usable(state.J):
            found.append(state)
    return found


@cache
def mujoco_model() -> Any:
    return mujoco.MjModel.from_xml_path(str(arm_path("panda")))


def mujoco_acceleration(arm: ArmSnapshot, tau: Array) -> Array:
    """What the torque does to the arm, (n,) rad/s^2: MuJoCo's word, in which no equation of this project takes part."""
    data = mujoco.MjData(mujoco_model())
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = arm.q, arm.qd, tau
    mujoco.mj_forward(mujoco_model(), data)
    qdd: Array = data.qacc.copy()
    return qdd


STATES = random_states(20)
D = np.linspace(10.0, 30.0, 7)
K = np.linspace(800.0, 200.0, 7)
Q_ERR = np.array([0.01, -0.02, 0.015, 0.02, -0.01, 0.03, -0.025])


def partition_rate(J: Array, Jdot: Array, Z: Array, pivots: tuple[int, ...]) -> Array:
    """Rate of the partition basis: the identity in it stays, the rest follows from Jdot Z + J Zdot = 0."""
    Zdot = np.zeros_like(Z)
    Zdot[list(pivots)] = -np.linalg.solve(J[:, list(pivots)], Jdot @ Z)
    return Zdot


def orthonormal(state: Terms) -> Array:
    return null_basis_orthonormal(state.J)


def continued(state: Terms) -> Array:
    """Carried over from where the arm was 1 ms ago."""
    before = terms(state.arm.q - 1e-3 * state.arm.qd, state.arm.qd)
    return null_basis_continued(null_basis_orthonormal(before.J), state.J, state.Jbar)


def partition(*pivots: int) -> Callable[[Terms], Array]:
    return lambda state: null_basis_partition(state.J, pivots)


BASES: dict[str, Callable[[Terms], Array]] = {
    "orthonormal": orthonormal,
    "continued": continued,
    **{f"partition{p}": partition(*p) for p in PIVOTS},
}


@dataclass(frozen=True)
class Null:
    """The null space's terms for one basis that moves in one way."""

    Z: Array
    Lambda: Array
    Zbar: Array
    Zbar_dot: Array
    mu: Array
    nu: Array

    def torque(self, qd: Array, B_nu: Array, K: Array = K, q_err: Array = Q_ERR) -> Array:
        return null_torque(self.Zbar, self.Lambda, self.Zbar_dot, qd, self.mu, B_nu, self.nu, self.Z, K, q_err)


def null(state: Terms, Z: Array, Zdot: Array) -> Null:
    arm = state.arm
    Lambda = null_inertia(Z, arm.M)
    Lambda_inv = inverse(Lambda)
    Zbar = null_inverse(Z, arm.M, Lambda_inv)
    Zbar_dot = null_inverse_rate(Z, Zdot, Zbar, arm.M, arm.C + arm.C.T, Lambda_inv)
    return Null(Z, Lambda, Zbar, Zbar_dot, null_coriolis(Z, arm.C, Lambda, Zbar_dot), null_velocity(Zbar, arm.qd))


def at_rest(state: Terms, Z: Array) -> Null:
    """The basis moves by null_basis_rate."""
    return null(state, Z, null_basis_rate(state.Jbar, state.Jdot, Z))


@pytest.mark.parametrize("name", BASES)
def test_no_motion_of_the_null_space_moves_the_task_and_the_inverses_belong_together(name: str) -> None:
    for state in STATES:
        Z = BASES[name](state)
        Zbar = null_inverse(Z, state.arm.M, inverse(null_inertia(Z, state.arm.M)))
        assert np.linalg.matrix_rank(Z) == 4
        close(state.J @ Z, np.zeros((3, 4)), ALGEBRA)
        close(state.J @ state.Jbar, np.eye(3), ALGEBRA)
        close(Zbar @ state.Jbar, np.zeros((4, 3)), ALGEBRA)
        close(Zbar @ Z, np.eye(4), ALGEBRA)
        # Eq. 12 is a change of coordinates: nothing of the motion is lost.
        close(state.Jbar @ state.J + Z @ Zbar, np.eye(7), ALGEBRA)


def test_the_papers_first_columns_are_singular_in_every_posture_of_this_arm() -> None:
    """The first joint is vertical: it neither lifts nor tilts the hand."""
    for state in STATES:
        assert np.abs(state.J[:, 0]).max() < 1e-15  # rounding of a product of rotations
        assert np.linalg.svd(state.J[:, :3], compute_uv=False)[-1] < 1e-15
    with pytest.raises(np.linalg.LinAlgError):
        null_basis_partition(np.array([[0.0, 1.0]]), [0])


def test_a_task_that_is_lost_is_an_error() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        task_inertia(np.array([[1.0, 0.0], [0.0, 0.0]]), np.eye(2))


def test_dynamically_consistent_inverse_takes_the_motion_of_least_kinetic_energy() -> None:
    """Minimise v^T M v / 2 under J v = b by its own optimality conditions: M v = J^T f, J v = b. The multiplier f is
    the impulse that makes the motion: Lambda_x b."""
    for state in STATES:
        system = np.block([[state.arm.M, -state.J.T], [state.J, np.zeros((3, 3))]])
        solution = np.linalg.solve(system, np.vstack([np.zeros((7, 3)), np.eye(3)]))
        close(state.Jbar, solution[:7], ALGEBRA)
        close(state.Lambda_x, solution[7:], ALGEBRA)


@pytest.mark.parametrize("name", BASES)
def test_task_and_null_space_do_not_accelerate_each_other(name: str) -> None:
    rng = np.random.default_rng(31)
    for state in STATES:
        part = at_rest(state, BASES[name](state))
        F, f = 100 * rng.normal(size=3), 100 * rng.normal(size=4)
        close(part.Zbar @ state.arm.M_inv @ state.J.T @ F, np.zeros(4), 100 * ALGEBRA)  # forces of 100
        close(state.J @ state.arm.M_inv @ part.Zbar.T @ f, np.zeros(3), 100 * ALGEBRA)


def law(state: Terms, part: Null, xdd_c: Array, tau_e: Array, K: Array = K, D: Array = D) -> Array:
    """The whole law, eq. 5, with the drift compensated."""
    arm = state.arm
    tau_task = task_torque(state.J, state.Lambda_x, xdd_c - task_drift(state.Jdot, arm.qd), state.Jbar, tau_e)
    return joint_torque(tau_task, part.torque(arm.qd, null_damping(part.Z, D), K), arm.C, arm.qd, arm.g)


def test_the_moving_arm_obeys_the_task_command_and_the_null_space_does_not_notice() -> None:
    """With accelerations from MuJoCo: xdd = xdd_c + Lambda_x^-1 J#^T tau_e whatever the null space does, and nud is
    the same whatever the task does."""
    rng = np.random.default_rng(32)
    for state in STATES:
        arm, part = state.arm, at_rest(state, null_basis_orthonormal(state.J))
        xdd_c, other_xdd_c = rng.normal(size=3), rng.normal(size=3)
        tau_e, other_tau_e = rng.normal(size=7), rng.normal(size=7)
        qdd = mujoco_acceleration(arm, law(state, part, xdd_c, tau_e))
        other_task = mujoco_acceleration(arm, law(state, part, other_xdd_c, other_tau_e))
        other_null = mujoco_acceleration(arm, law(state, part, xdd_c, tau_e, 3 * K, 0.1 * D))

        wanted = xdd_c + state.J @ arm.M_inv @ state.J.T @ state.Jbar.T @ tau_e
        close(state.J @ qdd + state.Jdot @ arm.qd, wanted, ALGEBRA)
        close(state.J @ other_null + state.Jdot @ arm.qd, wanted, ALGEBRA)
        assert np.abs(part.Zbar @ (other_null - qdd)).max() > 0.1  # the null space did change
        close(part.Zbar @ other_task, part.Zbar @ qdd, ALGEBRA)
        assert np.abs(state.J @ (other_task - qdd)).max() > 0.1  # the task did change


def on_a_path(state: Terms, qdd: Array, s: float) -> Terms:
    """The state s seconds later on the path with constant joint acceleration."""
    arm = state.arm
    return terms(arm.q + s * arm.qd + 0.5 * s * s * qdd, arm.qd + s * qdd)


Mover = Callable[[Terms, Terms, Array], Array]


def projected(now: Terms, then: Terms, Z: Array) -> Array:
    """The basis of now carried over to then, with nothing done to its columns: what null_basis_rate is the rate of."""
    return Z - then.Jbar @ (then.J @ Z)


def kept_orthonormal(now: Terms, then: Terms, Z: Array) -> Array:
    return null_basis_continued(Z, then.J, then.Jbar)


def partitioned(now: Terms, then: Terms, Z: Array) -> Array:
    return null_basis_partition(then.J, PIVOTS[0])


PATHS: dict[str, Mover] = {"projected": projected, "continued": kept_orthonormal, "partition": partitioned}


def start(path: str, state: Terms) -> Array:
    return null_basis_partition(state.J, PIVOTS[0]) if path == "partition" else null_basis_orthonormal(state.J)


@dataclass(frozen=True)
class Rates:
    """Central differences along a path: what the analytic rates must be."""

    Z: Array
    Zbar: Array
    Lambda: Array
    nu: Array


def rates(path: str, state: Terms, Z: Array, qdd: Array) -> Rates:
    sides = []
    for s in (H, -H):
        then = on_a_path(state, qdd, s)
        Z_then = PATHS[path](state, then, Z)
        Lambda = null_inertia(Z_then, then.arm.M)
        Zbar = null_inverse(Z_then, then.arm.M, inverse(Lambda))
        sides.append((Z_then, Zbar, Lambda, null_velocity(Zbar, then.arm.qd)))
    return Rates(*((after - before) / (2 * H) for after, before in zip(*sides, strict=True)))


def test_basis_rate_is_that_of_the_projected_basis_and_rests_in_the_metric_of_m() -> None:
    for state in STATES:
        Z = null_basis_orthonormal(state.J)
        Zdot = null_basis_rate(state.Jbar, state.Jdot, Z)
        close(Zdot, rates("projected", state, Z, np.zeros(7)).Z, DIFFERENCE)
        close(Z.T @ state.arm.M @ Zdot, np.zeros((4, 4)), ALGEBRA)


@pytest.mark.parametrize("path", PATHS)
def test_basis_rate_is_that_of_any_moving_basis_but_for_a_mixing_of_its_columns(path: str) -> None:
    """Z(t+h) = Z(t) + h (Zdot + Z W): the columns may be mixed by any W, which eq. 13 does not see."""
    for state in STATES:
        Z = start(path, state)
        found = rates(path, state, Z, np.zeros(7)).Z
        Zbar = null_inverse(Z, state.arm.M, inverse(null_inertia(Z, state.arm.M)))
        close(found - Z @ (Zbar @ found), null_basis_rate(state.Jbar, state.Jdot, Z), DIFFERENCE)


@pytest.mark.parametrize("path", PATHS)
def test_rate_of_the_null_inverse_is_its_derivative_along_the_motion(path: str) -> None:
    for state in STATES:
        Z = start(path, state)
        found = rates(path, state, Z, np.zeros(7))
        Zdot = null_basis_rate(state.Jbar, state.Jdot, Z) if path == "projected" else found.Z
        close(null(state, Z, Zdot).Zbar_dot, found.Zbar, DIFFERENCE)


@pytest.mark.parametrize("path", PATHS)
def test_null_coriolis_keeps_energy(path: str) -> None:
    """Lambda_nu_dot - 2 mu_nu is skew: the Coriolis force of the null space does no work."""
    for state in STATES:
        Z = start(path, state)
        found = rates(path, state, Z, np.zeros(7))
        mu = null(state, Z, found.Z).mu
        close(mu + mu.T, found.Lambda, DIFFERENCE)


@pytest.mark.parametrize("path", PATHS)
def test_eq_13_with_eq_5_gives_eq_11_on_the_moving_arm(path: str) -> None:
    """nu = Z# qd differentiated along the motion that MuJoCo makes of the torque: Lambda_nu nud + (mu_nu + B_nu) nu =
    Z^T K q_err. So C qd of eq. 5 and mu_nu of eq. 13 are both needed, and no force is counted twice."""
    rng = np.random.default_rng(33)
    for state in STATES:
        Z = start(path, state)
        Zdot = rates(path, state, Z, np.zeros(7)).Z
        part = null(state, Z, Zdot)
        B_nu = null_damping(Z, D)
        qdd = mujoco_acceleration(state.arm, law(state, part, rng.normal(size=3), rng.normal(size=7)))
        nud = rates(path, state, Z, qdd).nu
        close(part.Lambda @ nud, -(part.mu + B_nu) @ part.nu + Z.T @ (K * Q_ERR), DIFFERENCE)
        close(null_acceleration(inverse(part.Lambda), part.mu, B_nu, part.nu, Z, K, Q_ERR), nud, DIFFERENCE)


def mixed(state: Terms, seed: int) -> Null:
    """An orthonormal basis with its columns mixed by a random A(t): Z A, of rate Zdot A + Z Adot."""
    rng = np.random.default_rng(seed)
    A, Adot = 2.0 * np.eye(4) + 0.3 * rng.normal(size=(4, 4)), rng.normal(size=(4, 4))
    Z = null_basis_orthonormal(state.J)
    return null(state, Z @ A, null_basis_rate(state.Jbar, state.Jdot, Z) @ A + Z @ Adot)


def bases_and_rates(state: Terms) -> dict[str, Null]:
    """One state, many bases, each moving in its own way."""
    found = {"continued": at_rest(state, continued(state)), "mixed": mixed(state, 34), "mixed anew": mixed(state, 35)}
    for pivots in PIVOTS:
        Z = null_basis_partition(state.J, pivots)
        found[f"partition {pivots}"] = null(state, Z, partition_rate(state.J, state.Jdot, Z, pivots))
        found[f"partition {pivots} at rest"] = at_rest(state, Z)
    return found


def test_null_torque_does_not_depend_on_the_basis_nor_on_how_it_moves() -> None:
    for state in STATES:
        expected = at_rest(state, null_basis_orthonormal(state.J))
        torque = expected.torque(state.arm.qd, null_damping(expected.Z, D))
        for other in bases_and_rates(state).values():
            close(other.torque(state.arm.qd, null_damping(other.Z, D)), torque, ALGEBRA)


def test_null_torque_without_a_basis_is_eq_13() -> None:
    """What runs is the printed equation, for every basis, to rounding."""
    for state in STATES:
        arm = state.arm
        bases = {"orthonormal": at_rest(state, null_basis_orthonormal(state.J)), **bases_and_rates(state)}
        for part in bases.values():
            printed = part.torque(arm.qd, null_damping(part.Z, D))
            args = (state.J, state.Jdot, state.Jbar, state.Lambda_x, arm.C, D, arm.qd, K, Q_ERR)
            close(null_torque_projected(*args), printed, ALGEBRA)


def test_null_torque_would_depend_on_the_basis_with_the_printed_damping() -> None:
    """B_nu = 0.4 I (22.9 I in SI) in the coordinates of nu means another force for every basis."""
    B_nu = 22.9 * np.eye(4)
    for state in STATES:
        torque = at_rest(state, null_basis_orthonormal(state.J)).torque(state.arm.qd, B_nu)
        for name, other in bases_and_rates(state).items():
            # Only orthonormal bases agree: one is the other turned, and I turns into itself. (What the continued one
            # lacks of orthonormality shows here: 3e-4 N m; of the others none differs by less than 1 N m.)
            differs = np.abs(other.torque(state.arm.qd, B_nu) - torque).max()
            assert differs < 1e-3 if name == "continued" else differs > 0.5, (name, differs)


def test_continued_basis_stays_orthonormal_and_continuous_over_a_long_motion() -> None:
    """Half a second at the joints' speed limits, 1 ms steps. The projection shortens and shears the columns by up to
    e = 1.8e-3 a step here; one Newton-Schulz step leaves 3/4 e^2 = 2.4e-6 of that, and it must not add up."""
    state = terms(np.array([0.0, -0.1, 0.0, -2.1, 0.0, 2.0, 0.8]), np.zeros(7))
    Z = null_basis_orthonormal(state.J)
    for k in range(1, 501):
        phase = 2 * np.pi * 1e-3 * k + np.arange(7)
        then = terms(state.arm.q + 0.3 * (np.sin(phase) - np.sin(np.arange(7))), np.zeros(7))
        before, Z = Z, null_basis_continued(Z, then.J, then.Jbar)
        assert np.abs(then.J @ Z).max() < 1e-12  # rounding: J J# = I
        assert np.abs(Z.T @ Z - np.eye(4)).max() < 2.4e-6
        assert np.abs(Z - before).max() < 4e-3  # they turn by up to |J#| |Jdot| 1 ms: 2.9e-3 measured


# Stiffness and units.


def test_stiffness_in_si_is_the_papers_in_degrees() -> None:
    """Units converted by hand: 1 rad = 180/pi deg, so 1 N m/deg = 180/pi N m/rad."""
    rng = np.random.default_rng(36)
    deg = 180 / np.pi
    for _ in range(50):
        k_deg, q_err, rate = rng.uniform(1, 20, 7), 0.01 * rng.normal(size=7), 0.1 * rng.normal(size=7)
        by_platform = adaptive_stiffness_deg(k_deg, 100.0, q_err * deg, rate * deg)  # N m/deg
        in_si = adaptive_stiffness(k_deg * deg, 100.0, q_err, rate)  # N m/rad
        np.testing.assert_allclose(in_si, by_platform * deg, rtol=1e-13)  # a few roundings


def test_stiffness_at_rest_is_that_of_the_design_page() -> None:
    """K = k_nu + (867 p)^2 N m/rad on the unscaled projected error p = J# x_err, alpha 0.02, beta 100."""
    for state in STATES:
        x_err = np.array([0.01, 0.005, -0.008])
        p = state.Jbar @ x_err
        found = adaptive_stiffness(K, 100.0, projected_joint_error(0.02, state.Jbar, x_err), np.zeros(7)) - K
        # 867 is printed to three digits: 0.5 / 867, twice for the square; absolutely, rounding of K about 1000.
        np.testing.assert_allclose(found, (867 * p) ** 2, rtol=1.2e-3, atol=1e-12)


def test_motion_softens_and_stiffness_never_falls_below_its_least() -> None:
    q_err = np.array([0.01, 0.01, 0.01, 0.0])
    rate = np.array([0.0, 0.01, -0.01, -0.01])
    K = adaptive_stiffness(np.full(4, 286.0), 100.0, q_err, rate)
    assert K[0] > K[1] > 286.0
    assert (K[1], K[3]) == (K[2], 286.0)


# Signs and power.


def turned(r: Array) -> Array:
    """Rotation matrix of the rotation vector r (Rodrigues)."""
    angle = float(np.linalg.norm(r))
    x, y, z = r / angle
    S = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R: Array = np.eye(3) + np.sin(angle) * S + (1 - np.cos(angle)) * S @ S
    return R


E_Z = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("roll_pitch", [(1e-3, 0.0), (0.0, 1e-3), (-4e-4, 7e-4), (6e-4, 6e-4)])
def test_tilt_error_is_the_rotation_back_upright_for_small_roll_and_pitch(roll_pitch: tuple[float, float]) -> None:
    r = np.array([*roll_pitch, 0.0])
    # The sine of the angle: off by its third power over 6, 1.7e-10 for 1e-3.
    np.testing.assert_allclose(tilt_error(turned(r) @ E_Z), -r[:2], rtol=0, atol=2e-10)


def test_tilt_error_is_blind_to_yaw() -> None:
    tilted = turned(np.array([0.1, -0.2, 0.0]))
    for yaw in (0.3, -2.0, 3.1):
        turn = turned(yaw * E_Z)
        assert np.array_equal(tilt_error(turn @ E_Z), [0.0, 0.0])  # an upright hand that turned
        assert np.array_equal(tilt_error(tilted @ (turn @ E_Z)), tilt_error(tilted @ E_Z))  # a tilted one, round itself
        np.testing.assert_allclose(  # a tilted one, round the vertical: as tilted as before, in another direction
            np.linalg.norm(tilt_error(turn @ tilted @ E_Z)), np.linalg.norm(tilt_error(tilted @ E_Z)), rtol=1e-14
        )


def test_task_velocity_reduces_the_tilt_error_that_it_has() -> None:
    """The error's rate is minus the rows w_x, w_y of J qd when the hand is upright: the rows belong to the error."""
    for state in STATES:
        u_E = state.arm.R_BE.T @ E_Z
        after, before = (on_a_path(state, np.zeros(7), s).arm.R_BE @ u_E for s in (H, -H))
        rate = (tilt_error(after) - tilt_error(before)) / (2 * H)
        close(rate, -task_velocity(state.J, state.arm.qd)[1:], DIFFERENCE)


def test_a_hand_that_is_too_low_is_pushed_upwards() -> None:
    for state in STATES:
        x_err = np.array([0.01, 0.0, 0.0])  # x_d - x: wanted 10 mm above where it is
        xdd_c = task_acceleration(np.zeros(3), np.zeros(3), x_err, np.full(3, 1.0), np.full(3, 80.0))
        tau = task_torque(state.J, state.Lambda_x, xdd_c, state.Jbar, np.zeros(7))
        qdd = mujoco_acceleration(state.arm, tau + state.arm.C @ state.arm.qd + state.arm.g)
        close(state.J @ qdd, np.array([0.8, 0.0, 0.0]), ALGEBRA)  # 80 1/s^2 times 10 mm, and no tilting
        # The observer is a spring: an upward force too. (Not decoupled: it tilts as well, and by way of that the
        # acceleration can even be downwards in postures far from the working one.)
        assert (state.Jbar.T @ external_torque(K, state.Jbar, x_err))[0] > 0


def test_task_damping_takes_twice_the_tasks_kinetic_energy_per_time_constant() -> None:
    """qd^T J^T Lambda_x (-B_e xd) with B_e = b I is -2 b times the least kinetic energy of that task motion."""
    b = 1.0
    for state in STATES:
        qd = state.arm.qd
        xdd_c = task_acceleration(
            np.zeros(3), -task_velocity(state.J, qd), np.zeros(3), np.full(3, b), np.full(3, 80.0)
        )
        power = qd @ task_torque(state.J, state.Lambda_x, xdd_c, state.Jbar, np.zeros(7))
        slowest = state.Jbar @ (state.J @ qd)
        energy = 0.5 * slowest @ state.arm.M @ slowest
        assert power < 0
        assert power == pytest.approx(-2 * b * energy, rel=ALGEBRA)


def test_null_damping_takes_what_joint_dampers_take_from_the_null_motion() -> None:
    """The damping's part of eq. 13 has the power -nu^T B_nu nu: that of dampers D on the joints at the speeds Z nu."""
    for state in STATES:
        part = at_rest(state, null_basis_orthonormal(state.J))
        qd, B_nu = state.arm.qd, null_damping(part.Z, D)
        torque = part.torque(qd, B_nu) - part.torque(qd, np.zeros((4, 4)))
        null_motion = qd - state.Jbar @ (state.J @ qd)
        assert qd @ torque < 0
        assert qd @ torque == pytest.approx(-(D * null_motion) @ null_motion, rel=ALGEBRA)
