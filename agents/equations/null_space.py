"""The null space: everything the joints can do without moving the task (equations 11 to 13).

The torque of eq. 13 does not depend on which basis Z is chosen, nor on how that basis moves in time, as long as
``Zdot`` belongs to ``Z`` and the damping is joint damping carried over; a test holds it to that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def null_basis_partition(J: Array, pivots: Sequence[int]) -> Array:
    """Null-space basis from a partition of the columns, (n, r): Z = [-J_m^-1 J_r; I]. Paper, text before eq. 12.

    Printed without the minus sign that J Z = 0 needs. The paper takes the first m columns as J_m, which is singular
    in some postures; here the caller names them.

    Args:
        J: task Jacobian, (m, n).
        pivots: m column indices such that J_m = J[:, pivots] is invertible.

    Raises:
        numpy.linalg.LinAlgError: J_m is singular.
    """
    m, n = J.shape
    rest = [column for column in range(n) if column not in pivots]
    Z = np.zeros((n, n - m))
    Z[list(pivots)] = -np.linalg.solve(J[:, list(pivots)], J[:, rest])
    Z[rest] = np.eye(n - m)
    return Z


def null_basis_orthonormal(J: Array) -> Array:
    """Null-space basis with orthonormal columns, (n, r), from the QR factors of J^T: well made while J has rank."""
    m = J.shape[0]
    Q: Array = np.linalg.qr(J.T, mode="complete")[0]
    return Q[:, m:]


def null_basis_continued(Z: Array, J: Array, Jbar: Array) -> Array:
    """The basis of the tick before carried over to this J, (n, r): (I - J# J) Z, brought back to orthonormal columns.

    Continuous in time, and a quarter of the cost of a new one. One Newton-Schulz step, Z (3 I - Z^T Z) / 2, is exact
    to second order in what the arm moved since; J Z = 0 holds exactly, since J J# = I.

    Args:
        Z: an orthonormal basis for a posture close by, (n, r).
    """
    Z = Z - Jbar @ (J @ Z)
    return Z @ (1.5 * np.eye(Z.shape[1]) - 0.5 * (Z.T @ Z))


def null_basis_rate(Jbar: Array, Jdot: Array, Z: Array) -> Array:
    """Rate of the basis, (n, r): Zdot = -J# Jdot Z.

    J Z = 0 asks for J Zdot = -Jdot Z; of all rates that keep it, this one leaves the basis at rest in the metric of M
    (Z^T M Zdot = 0), so no history of Z is needed. Eq. 13 gives the same torque for every rate that keeps J Z = 0.
    """
    return -Jbar @ (Jdot @ Z)


def null_inertia(Z: Array, M: Array) -> Array:
    """Inertia in the null space, (r, r): Lambda_nu = Z^T M Z. Paper, text after eq. 11 (its reference 16)."""
    return Z.T @ M @ Z


def null_inverse(Z: Array, M: Array, Lambda_nu_inv: Array) -> Array:
    """Inverse of the basis that the inertia agrees with, (r, n): Z# = Lambda_nu^-1 Z^T M. Paper eq. 12."""
    return Lambda_nu_inv @ (Z.T @ M)


def null_velocity(Zbar: Array, qd: Array) -> Array:
    """Null-space velocity, (r,): nu = Z# qd. Paper eq. 12, lower row."""
    return Zbar @ qd


def null_inverse_rate(Z: Array, Zdot: Array, Zbar: Array, M: Array, Mdot: Array, Lambda_nu_inv: Array) -> Array:
    """Rate of Z#, (r, n): the derivative of Lambda_nu^-1 Z^T M.

    Args:
        Mdot: rate of M, (n, n); C + C^T when C is the Coriolis matrix of the Christoffel symbols.
    """
    ZTM_dot = Zdot.T @ M + Z.T @ Mdot
    Lambda_nu_dot = ZTM_dot @ Z + Z.T @ M @ Zdot
    return Lambda_nu_inv @ (ZTM_dot - Lambda_nu_dot @ Zbar)


def null_coriolis(Z: Array, C: Array, Lambda_nu: Array, Zbar_dot: Array) -> Array:
    """Coriolis matrix in the null space, (r, r): mu_nu = (Z^T C - Lambda_nu Z#dot) Z. Paper eq. 11 (its reference 16).

    Eq. 5 adds C qd once more; with this mu_nu both are right and neither may be "simplified" away.
    """
    return (Z.T @ C - Lambda_nu @ Zbar_dot) @ Z


def null_damping(Z: Array, D: Array) -> Array:
    """Null-space damping, (r, r): B_nu = Z^T D Z.

    The paper prints 0.4 I in the coordinates of nu, which means something else for every basis. Read as joint damping
    D (n,) N m s/rad carried over, the torque is the same for all bases.
    """
    return (Z.T * D) @ Z


def null_acceleration(
    Lambda_nu_inv: Array, mu_nu: Array, B_nu: Array, nu: Array, Z: Array, K: Array, q_err: Array
) -> Array:
    """Commanded null-space acceleration, (r,). Paper eq. 11:

    nud_c = -Lambda_nu^-1 ((mu_nu + B_nu) nu - Z^T K q_err)
    """
    return -Lambda_nu_inv @ ((mu_nu + B_nu) @ nu - Z.T @ (K * q_err))


def null_torque(
    Zbar: Array,
    Lambda_nu: Array,
    Zbar_dot: Array,
    qd: Array,
    mu_nu: Array,
    B_nu: Array,
    nu: Array,
    Z: Array,
    K: Array,
    q_err: Array,
) -> Array:
    """Joint torque of the null space, (n,) N m. Paper eq. 13:

        tau_null = -Z#^T (Lambda_nu Z#dot qd + (mu_nu + B_nu) nu - Z^T K q_err)

    Args:
        K: joint stiffness, (n,) diagonal, N m/rad: K_nu, or K_var of eq. 15.
        q_err: projected joint error of eq. 14, (n,) rad.
    """
    return -Zbar.T @ (Lambda_nu @ (Zbar_dot @ qd) + (mu_nu + B_nu) @ nu - Z.T @ (K * q_err))


def null_projection(J: Array, Jbar: Array, tau: Array) -> Array:
    """The part of a joint torque that does not accelerate the task, (n,) N m: (I - J^T J#^T) tau."""
    return tau - J.T @ (Jbar.T @ tau)


def null_torque_projected(
    J: Array, Jdot: Array, Jbar: Array, Lambda_x: Array, C: Array, D: Array, qd: Array, K: Array, q_err: Array
) -> Array:
    """Joint torque of the null space without a basis, (n,) N m: eq. 13 with everything that depends on Z cancelled out.

    With the projector P = I - J# J = Z Z#, joint damping D carried over as in :func:`null_damping`, Mdot = C + C^T, and
    Z# J# = 0 differentiated in time, eq. 13 is

        tau_null = -P^T (C P qd + (Mdot J# - Jdot^T Lambda_x) xd + D P qd - K q_err),    xd = J qd

    An identity, not an approximation: a test holds it to eq. 13 as printed, for several bases. It is what runs, at a
    third of the cost, and it shows that the torque is a matter of J alone, not of Z.

    Args:
        D: joint damping, (n,) diagonal, N m s/rad.
        K: joint stiffness, (n,) diagonal, N m/rad: K_nu, or K_var of eq. 15.
        q_err: projected joint error of eq. 14, (n,) rad.
    """
    xd = J @ qd
    qd_task = Jbar @ xd
    qd_null = qd - qd_task
    wanted = C @ qd + C.T @ qd_task - Jdot.T @ (Lambda_x @ xd) + D * qd_null - K * q_err
    return J.T @ (Jbar.T @ wanted) - wanted
