"""The hand's yaw against the base: a spring that the paper does not have (ours)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def yaw_moment(ahead: Array, ahead_held: Array, yaw_rate: Any, k: float, b: float) -> Any:
    """Moment about the base's z on the hand, N m: k sin(psi_held - psi) - b psi_rate. Ours.

    The sine needs no angle and so never wraps; it fades past 90 degrees, where the spring would have to give anyway.

    Args:
        ahead, ahead_held: the hand's x axis, now and as held, (3,) unit vectors in B, near the horizontal.
        yaw_rate: of the hand against the base, rad/s.
        k, b: N m/rad, N m s/rad.
    """
    return k * (ahead[0] * ahead_held[1] - ahead[1] * ahead_held[0]) - b * yaw_rate


def yaw_sine(ahead_held: Array, ahead: Array) -> Any:
    """Sine of the angle that the hand's x axis has turned by, about the base's z; both (3,) unit vectors in B. Ours."""
    return ahead_held[0] * ahead[1] - ahead_held[1] * ahead[0]


def reaction_moment(p: Array, F: Array, moment: Any) -> Any:
    """Moment about the base's z, N m, that keeps the base from being turned by what its hand does: (p x F)_z + moment.
    Ours.

    A hand that holds a load by its yaw pushes the base round the other way; a base with nothing but the resistance of
    its wheels gives way, and the load with it.

    Args:
        p: the hand in B, (3,) m.
        F: its force on the load in the plane, (2,) N.
        moment: its moment on the load about z, N m.
    """
    return p[0] * F[1] - p[1] * F[0] + moment
