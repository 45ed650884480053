"""The pull of the load as the wrist feels it: the other input of the base (section IV-D). Numbers or symbols alike.

The wrist measures what the arm exerts on the hand and all that the hand holds. In the plane, where weight has no part,
the load pulls the hand with what moves the hand less that: F = d/dt (m v) - F_wrist.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agents.equations.chain import cross

Array = NDArray[np.float64]


def planar_wrist_force(F_W: Array, R_BW: Array) -> Array:
    """What the arm exerts on the hand, in the plane of the base frame B, (2,) N.

    Args:
        F_W: measured force in the wrist's frame, (3,) N.
        R_BW: that frame in B, (3, 3).
    """
    return (R_BW @ F_W)[:2]


def planar_momentum(mass: float, v_E: Array, w: Array, r: Array) -> Array:
    """Momentum of the hand in the plane, (2,) kg m/s; of its velocity in B, since nobody tells the base's.

    Args:
        v_E, w: velocity of the tool centre and angular velocity, (3,) m/s, rad/s in B.
        r: from the tool centre to the hand's centre of mass, (3,) m in B.
    """
    return mass * (v_E + cross(w, r))[:2]


def planar_spring(displacement: Array, k_env: float) -> Array:
    """Force that draws the hand back to its place over the base, (2,) N: -k_env dx."""
    return -k_env * displacement


def displacement_of_force(F_est: Array, k_env: float) -> Array:
    """Displacement that a force stands for, (2,) m: dx of F_est = k_env dx. Paper section IV-D."""
    return F_est / k_env
