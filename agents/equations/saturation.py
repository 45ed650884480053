"""What to give up when a joint cannot deliver its torque (ours)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agents.equations.bounds import limited

Array = NDArray[np.float64]


def yield_moment(tau: Array, J_w: Array, tau_max: Array, joints: Sequence[int]) -> Array:
    """Joint torque, (n,) N m, in which these joints stay within limits and the hand's force is what it was. Ours.

    A joint that is clipped alone makes the others' torques mean another force at the hand: a wrist that cannot hold a
    load level then pushes it sideways for as long as it tries. Taking off a moment about that joint's own axis,
    J_w^T a_i (tau_i - limit), gives up exactly what it cannot deliver: a_i . a_i = 1, and a moment is no force.

    Args:
        tau: wanted, (n,) N m.
        J_w: angular rows of the hand's Jacobian, (3, n); column i is the axis a_i.
        tau_max: (n,) N m.
        joints: which may yield, in this order: the last ones, whose axes the hand's moments go through.
    """
    for i in joints:
        tau = tau - (J_w.T @ J_w[:, i]) * (tau[i] - limited(tau[i], -tau_max[i], tau_max[i]))
    return tau
