"""Hands that hold nothing: fingers that open and close, and whether a strut is between them when they do.

A hand that holds is a weld and needs none of this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_server.layout import STRUT_SIDE_M, Array, Pose

OPEN_M = 0.08
"""Widest opening of the Panda's fingers."""
FINGER_SPEED_M_S = 0.1
ALONG_M, ABOVE_M, TILT_RAD = 0.06, 0.015, math.radians(12)
"""How far off the hand may be and still hold: along the strut, above or below it, and turned."""


@dataclass(slots=True)
class Hand:
    """An empty hand, and the odometer of its base.

    Attributes:
        origin: x, y [m], yaw [rad] of the base where its odometer began, in the world.
        opening_m, wanted_m: how far the fingers are open, and shall be.
    """

    origin: Array
    opening_m: float = OPEN_M
    wanted_m: float = OPEN_M

    def move(self, dt_s: float) -> bool:
        """Move the fingers for one tick; True at the moment at which a strut between them would be held."""
        step = FINGER_SPEED_M_S * dt_s
        before = self.opening_m
        self.opening_m += min(max(self.wanted_m - before, -step), step)
        return before > STRUT_SIDE_M >= self.opening_m

    def odometry(self, base: Array, base_rate: Array) -> tuple[float, ...]:
        """x, y, yaw in the frame where the odometer began, and the velocity in the base's own frame, (6,).

        Args:
            base, base_rate: x, y, yaw and their rates, in the world, (3,) each.
        """
        dx, dy = base[:2] - self.origin[:2]
        c, s = math.cos(self.origin[2]), math.sin(self.origin[2])
        cb, sb = math.cos(base[2]), math.sin(base[2])
        vx, vy, turn = base_rate
        return (
            float(c * dx + s * dy),
            float(c * dy - s * dx),
            float(base[2] - self.origin[2]),
            float(cb * vx + sb * vy),
            float(cb * vy - sb * vx),
            float(turn),
        )


def would_hold(X_GE: Pose) -> bool:
    """Whether fingers that close now hold the strut; ``X_GE``: the hand, seen from one that holds it squarely."""
    x, y, z = np.abs(X_GE.p)
    turned = math.acos(min(1.0, max(-1.0, (float(np.trace(X_GE.R)) - 1) / 2)))
    across = (OPEN_M - STRUT_SIDE_M) / 2
    return bool(x <= ALONG_M and y <= across and z <= ABOVE_M and turned <= TILT_RAD)
