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
