"""The assembled joint torque (equation 5) and the mobile base (equation 16)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def joint_torque(tau_task: Array, tau_null: Array, C: Array, qd: Array, g: Array) -> Array:
    """Commanded joint torque, (n,) N m: tau = tau_task + tau_null + C qd + g. Paper eq. 5."""
    return tau_task + tau_null + C @ qd + g


def base_force(e: Array, e_rate: Array, K_m: float, B_m: float) -> Array:
    """Force that drives the mobile base, (2,) N in the base frame B: F_m = K_m e + B_m e_rate. Paper eq. 16.

    Args:
        e: how far the hand is from its neutral place, (2,) m, in B: (x, y) - (x0, y0).
        e_rate: its rate, (2,) m/s.
        K_m, B_m: 2000 N/m, 20 N s/m in the paper.
    """
    return K_m * e + B_m * e_rate
