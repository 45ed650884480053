"""The state observer and the adaptive stiffness (equations 14 and 15), in the paper's degrees and in SI."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEG = float(180.0 / np.pi)
"""Degrees in a radian; a gain per degree times DEG is the gain per radian."""


def projected_joint_error(alpha: float, Jbar: Array, x_err: Array) -> Array:
    """Projected joint error q_d - q, (n,) rad: q_err = alpha J# x_err. Paper eq. 14.

    Args:
        alpha: "some small scaling constant proportional to the control loop time step"; 0.02, the step of the paper's
            platform. With alpha = 1 the null space pushes the base along for ever.
    """
    return alpha * (Jbar @ x_err)


def projected_error_rate(alpha: float, Jbar: Array, xd_err: Array) -> Array:
    """Rate of the projected joint error, (n,) rad/s: alpha J# xd_err.

    The motion of J# itself is left out: it is of second order in the (small) error.
    """
    return alpha * (Jbar @ xd_err)


def adaptive_stiffness_deg(k_nu: Array, beta: float, q_err_deg: Array, q_err_rate_deg: Array) -> Array:
    """Adaptive joint stiffness as the paper's platform computes it, (n,) N m/deg. Paper eq. 15:

        K_ii = k_nu + (beta q_err_i / (1 + |d q_err_i / dt|))^2

    Printed without the absolute value, the denominator vanishes at a rate of -1. The rate is that of the error in
    degrees per second.

    Args:
        k_nu: least stiffness, (n,) N m/deg.
        beta: gain, (N m/deg)^(1/2)/deg.
        q_err_deg, q_err_rate_deg: projected joint error and its rate, (n,) deg, deg/s.
    """
    return k_nu + (beta * q_err_deg / (1.0 + np.abs(q_err_rate_deg))) ** 2


def adaptive_stiffness(k_nu: Array, beta: float, q_err: Array, q_err_rate: Array) -> Array:
    """Adaptive joint stiffness in SI, (n,) N m/rad. Paper eq. 15 with the printed beta, which is per degree.

    The same number as :func:`adaptive_stiffness_deg`, from radians to N m/rad: the square takes degrees twice, the
    stiffness once more.

    Args:
        k_nu: least stiffness, (n,) N m/rad.
        beta: the printed gain (100), per degree.
        q_err, q_err_rate: projected joint error and its rate, (n,) rad, rad/s.
    """
    beta_rad = beta * DEG * DEG**0.5
    K: Array = k_nu + (beta_rad * q_err / (1.0 + DEG * np.abs(q_err_rate))) ** 2
    return K
