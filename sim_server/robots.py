"""The robots: a planar mobile base with a pedestal, the arm on top, and how they stand at the start."""

from __future__ import annotations

import math

import numpy as np

from sim_server.errors import SimError
from sim_server.layout import BASE_FOOTPRINT_M, Array, LayoutError, Pose
from sim_server.parts import Colour, Part, Touch

HOME: dict[str, tuple[float, ...]] = {
    "panda": (0.0, -0.1, 0.0, -2.1, 0.0, 2.0, math.pi / 4),
}
"""Joint positions [rad] at the start, per arm: the hand points straight down, its x axis along the base's, so that the
fingers close along the base's y. The Panda's joint6 is joint2 - joint4 for that; 0.8 rad and more from every limit."""

R_SE: Array = np.diag([-1.0, 1.0, -1.0])
"""The hand's axes at a strut, grasping from above: approach (z) down, fingers (y) across the strut, x to the load."""

CARRY_HEIGHT_M = 0.10
"""Least height of the carried load's lowest point above the floor."""
PEDESTAL_MIN_M = 0.30
"""Height of the arm's foot above the floor at least: the base and its turntable. Low loads are carried higher."""
PEDESTAL_MAX_M = 0.80

DECK_BOTTOM_M, DECK_TOP_M = 0.06, 0.25
WHEEL_DIAMETER_M, WHEEL_WIDTH_M = 0.16, 0.06

WHITE: Colour = (0.90, 0.90, 0.89)
DARK: Colour = (0.20, 0.21, 0.23)
ACCENTS: tuple[Colour, ...] = (
    (0.00, 0.45, 0.70),
    (0.90, 0.62, 0.00),
    (0.00, 0.62, 0.45),
    (0.80, 0.47, 0.65),
    (0.34, 0.71, 0.91),
    (0.84, 0.37, 0.00),
    (0.94, 0.89, 0.26),
    (0.35, 0.35, 0.35),
)
"""Okabe and Ito's colours, told apart by colour-blind people too; they repeat after eight arms."""


class NoHome(SimError):
    """An arm without a starting posture."""

    def __init__(self, arm: str) -> None:
        self.arm = arm
        super().__init__(
            f"team.arm: no starting posture for arm {arm!r}; expected one of: {', '.join(HOME)}. "
            "Add one to HOME in sim_server/robots.py"
        )


def home(arm: str) -> Array:
    """Joint positions (n,) [rad] at the start. Raises ``NoHome``."""
    if arm not in HOME:
        raise NoHome(arm)
    return np.array(HOME[arm])


def pedestal_height_m(strut_level_m: float, reach_height_m: float) -> float:
    """Height of the arm's foot above the floor [m] for struts ``strut_level_m`` above the load's lowest point.

    ``reach_height_m``: the tool's height above the arm's foot in the starting posture. Raises ``LayoutError`` for a
    load that is too high.
    """
    height = max(PEDESTAL_MIN_M, CARRY_HEIGHT_M + strut_level_m - reach_height_m)
    if height > PEDESTAL_MAX_M:
        raise LayoutError(
            "load.size_m",
            f"grasping {strut_level_m:.2f} m above the load's lowest point needs a pedestal of {height:.2f} m",
            expected=f"at most {PEDESTAL_MAX_M} m",
            fix=f"A load lower by {height - PEDESTAL_MAX_M:.2f} m",
        )
    return height


def base_parts(pedestal_m: float, accent: Colour) -> list[Part]:
    """Shapes of the mobile base in its frame B (on the floor, x forward): deck, wheels, pedestal, a coloured band."""
    length, width = BASE_FOOTPRINT_M
    deck = DECK_TOP_M - DECK_BOTTOM_M
    mid = (DECK_TOP_M + DECK_BOTTOM_M) / 2
    wheel_x, wheel_y = length / 2 - WHEEL_DIAMETER_M / 2 - 0.02, width / 2 - WHEEL_WIDTH_M / 2 + 0.004
    wheels = [
        Part(
            "cylinder",
            (WHEEL_DIAMETER_M, WHEEL_DIAMETER_M, WHEEL_WIDTH_M),
            Pose(np.array([sx * wheel_x, sy * wheel_y, WHEEL_DIAMETER_M / 2]), _Z_TO_Y),
            DARK,
        )
        for sx in (1, -1)
        for sy in (1, -1)
    ]
    inner = width - 2 * WHEEL_WIDTH_M - 0.02
    column = pedestal_m - DECK_TOP_M
    return [
        Part("box", (length, width, deck), Pose.planar(0, 0, mid), WHITE, Touch.BASE),
        Part("box", (length - 0.04, inner, 0.02), Pose.planar(0, 0, DECK_BOTTOM_M - 0.01), DARK),
        Part("box", (length + 0.004, width + 0.004, 0.035), Pose.planar(0, 0, DECK_TOP_M - 0.035), accent),
        Part("box", (0.26, 0.22, column), Pose.planar(-0.03, 0, DECK_TOP_M + column / 2), DARK),
        *wheels,
    ]


_Z_TO_Y: Array = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
