"""The task space: height, roll and pitch of the hand (equations 6 to 10)."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def task_velocity(J: Array, qd: Array) -> Array:
    """Velocity of the task, (m,): xd = J qd. Paper eq. 7.

    Args:
        J: task Jacobian, (m, n).
        qd: joint velocities, (n,) rad/s.
    """
    return J @ qd


UPRIGHT: Array = np.array([0.0, 0.0, 1.0])


def tilt_error(u: Array, u_d: Array = UPRIGHT) -> Array:
    """Roll and pitch that are missing to bring the axis ``u`` to ``u_d``, (2,) rad: x and y of u x u_d.

    No Euler angles, no wrap, and blind to yaw: turning about the vertical changes nothing. Exact for small tilts
    (it is the sine of the angle). Our reading of the paper's (theta, phi), which it leaves undefined.

    Args:
        u: the hand's axis that was vertical at the grasp, (3,) unit vector in frame B.
        u_d: where it shall point, (3,) unit vector in frame B; upright unless there is a reference.
    """
    return np.array([u[1] * u_d[2] - u[2] * u_d[1], u[2] * u_d[0] - u[0] * u_d[2]])


def task_acceleration(xdd_d: Array, xd_err: Array, x_err: Array, B_e: Array, K_e: Array) -> Array:
    """Commanded task acceleration, (m,): xdd_c = xdd_d + B_e (xd_d - xd) + K_e (x_d - x). Paper eq. 6.

    Printed with ``+ B_e xd``; read as in eq. 2, damping the error's rate (a positive B_e would feed motion).

    Args:
        xdd_d: desired task acceleration, (m,) m/s^2, rad/s^2.
        xd_err: xd_d - xd, (m,) m/s, rad/s.
        x_err: x_d - x, (m,) m, rad.
        B_e: task damping, (m,) diagonal, 1/s.
        K_e: task stiffness, (m,) diagonal, 1/s^2.
    """
    return xdd_d + B_e * xd_err + K_e * x_err


def task_drift(Jdot: Array, qd: Array) -> Array:
    """Task acceleration of an arm that moves on without joint acceleration, (m,): Jdot qd.

    Ours, not the paper's: eq. 9 leaves it out, and without its compensation the task is not decoupled while the arm
    moves. Subtract it from the commanded acceleration.
    """
    return Jdot @ qd


def task_inertia(J: Array, M_inv: Array) -> Array:
    """Inertia that the task feels, (m, m): Lambda_x = (J M^-1 J^T)^-1. Text before paper eq. 9.

    Raises:
        numpy.linalg.LinAlgError: J has lost rank (the arm cannot move in some task direction).
    """
    return _inverse(J @ M_inv @ J.T)


def _inverse(A: Array) -> Array:
    """Inverse of a symmetric positive definite matrix. Of symbols (agents/tracing.py) by Gauss-Jordan elimination,
    which needs no pivoting there."""
    if A.dtype != object:
        return cast(Array, np.linalg.inv(A))
    n = len(A)
    rows = np.hstack([A, np.eye(n, dtype=object)])
    for k in range(n):
        rows[k] = rows[k] / rows[k, k]
        for other in range(n):
            if other != k:
                rows[other] = rows[other] - rows[k] * rows[other, k]
    return rows[:, n:]


def dynamically_consistent_inverse(J: Array, M_inv: Array, Lambda_x: Array) -> Array:
    """The one right inverse of J that the inertia agrees with, (n, m): J# = M^-1 J^T (J M^-1 J^T)^-1. Paper eq. 8."""
    return M_inv @ J.T @ Lambda_x


def external_torque(K: Array, Jbar: Array, x_err: Array) -> Array:
    """Disturbance observer: the external torque that the task error tells of, (n,) N m: tau_e = K_nu J# x_err.

    Paper eq. 10. A spring, not an integrator: it carries part of the load only while there is an error.

    Args:
        K: joint stiffness, (n,) diagonal, N m/rad; K_nu, or K_var of eq. 15.
        Jbar: J#, (n, m).
        x_err: x_d - x, (m,).
    """
    return K * (Jbar @ x_err)


def task_torque(J: Array, Lambda_x: Array, xdd_c: Array, Jbar: Array, tau_e: Array) -> Array:
    """Joint torque of the task, (n,) N m: tau_task = J^T (Lambda_x xdd_c + J#^T tau_e). Paper eq. 9."""
    return J.T @ (Lambda_x @ xdd_c + Jbar.T @ tau_e)
