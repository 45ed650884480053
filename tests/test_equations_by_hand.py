"""The paper's equations against numbers solved by hand for a two-link arm."""

from __future__ import annotations

import numpy as np
import pytest

from agents.equations.law import base_force, joint_torque
from agents.equations.null_space import (
    null_acceleration,
    null_basis_partition,
    null_basis_rate,
    null_coriolis,
    null_damping,
    null_inertia,
    null_inverse,
    null_inverse_rate,
    null_torque,
    null_velocity,
)
from agents.equations.stiffness import adaptive_stiffness_deg, projected_error_rate, projected_joint_error
from agents.equations.task import (
    dynamically_consistent_inverse,
    external_torque,
    task_acceleration,
    task_drift,
    task_inertia,
    task_torque,
    task_velocity,
)

EXACT = 1e-14
"""For sums by hand with numbers up to 100: one or two roundings."""


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
