"""The loads: their shapes, their mass and inertia, and their named points. All in the load's frame O."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim_server.layout import (
    GRASP_OUTSIDE_M,
    HANDLE_ABOVE_M,
    LEG_INSET_M,
    LEG_SIDE_M,
    STRUT_SIDE_M,
    STRUT_VISIBLE_M,
    TOP_THICKNESS_M,
    Array,
    LayoutError,
    Pose,
    strut_level_m,
    strut_poses,
)
from sim_server.parts import Inertia, Part, Touch, uniform_inertia
from sim_server.scenario import Load, LoadPoint

STRUT_UNDER_TOP_M = 0.10
"""Length of a strut under the table's top, where it is fastened."""
HANDLE_LENGTH_M = 0.18
"""Length of the single bearer's handle: a hand between its posts."""

WOOD = (0.76, 0.58, 0.38)
DARK_WOOD = (0.55, 0.39, 0.24)
STEEL = (0.45, 0.47, 0.50)


@dataclass(frozen=True, eq=False)
class LoadBody:
    """A load, ready to be placed in a world.

    Attributes:
        parts: its shapes, in O.
        inertia: its mass, centre of mass and inertia, in O.
        struts: poses ``X_OS`` of its struts.
        points: the named points a leader may pull at, (3,) [m] in O: on the rim at the struts' level, ``centre`` above
            O.
    """

    parts: list[Part]
    inertia: Inertia
    struts: list[Pose]
    points: dict[LoadPoint, Array]


def load_body(load: Load) -> LoadBody:
    """Shapes and inertia of the scenario's load. Raises ``LayoutError`` when its struts or legs do not fit.

    The mass is exactly ``load.mass_kg``, spread evenly over all parts, struts included. Then the centre of mass is
    moved by ``centre_of_mass_offset_m``; the inertia about the centre of mass stays, as if ballast had been moved.
    """
    struts = strut_poses(load)
    if load.shape == "block":
        parts = [Part("box", load.size_m, Pose.planar(0, 0, load.size_m[2] / 2), STEEL, Touch.STRUT)]
    else:
        parts = _table(load) if load.shape == "table" else _crate(load)
        parts += _handle(load) if load.struts == 1 else _strut_bars(load, struts)
    even = uniform_inertia(parts, load.mass_kg)
    inertia = replace(even, com=even.com + np.array(load.centre_of_mass_offset_m))
    return LoadBody(parts, inertia, struts, _points(load))


def _points(load: Load) -> dict[LoadPoint, Array]:
    length, width, _ = load.size_m
    z = strut_level_m(load)
    return {
        "centre": np.array([0.0, 0.0, z]),
        "front": np.array([length / 2, 0.0, z]),
        "back": np.array([-length / 2, 0.0, z]),
        "left": np.array([0.0, width / 2, z]),
        "right": np.array([0.0, -width / 2, z]),
    }


def _table(load: Load) -> list[Part]:
    length, width, height = load.size_m
    smallest = 2 * (LEG_INSET_M + LEG_SIDE_M) + STRUT_SIDE_M
    under = height - TOP_THICKNESS_M
    lowest = TOP_THICKNESS_M + 2 * STRUT_SIDE_M
    if min(length, width) < smallest or height < lowest:
        raise LayoutError(
            "load.size_m",
            f"a table of {length} x {width} x {height} m has no room for its legs",
            expected=f"at least {smallest:.2f} m in length and width and {lowest:.2f} m in height",
        )
    x, y = length / 2 - LEG_INSET_M - LEG_SIDE_M / 2, width / 2 - LEG_INSET_M - LEG_SIDE_M / 2
    top_middle = Pose.planar(0, 0, under + TOP_THICKNESS_M / 2)
    top = Part("box", (length, width, TOP_THICKNESS_M), top_middle, WOOD, Touch.LOAD)
    legs = [
        Part("box", (LEG_SIDE_M, LEG_SIDE_M, under), Pose.planar(sx * x, sy * y, under / 2), DARK_WOOD, Touch.LOAD)
        for sx in (1, -1)
        for sy in (1, -1)
    ]
    return [top, *legs]


def _crate(load: Load) -> list[Part]:
    return [Part("box", load.size_m, Pose.planar(0, 0, load.size_m[2] / 2), WOOD, Touch.LOAD)]


def _strut_bars(load: Load, struts: list[Pose]) -> list[Part]:
    """One bar per strut: from the rim outward, and a table's from under its top."""
    inner = STRUT_UNDER_TOP_M if load.shape == "table" else 0.0
    size = (STRUT_VISIBLE_M + inner, STRUT_SIDE_M, STRUT_SIDE_M)
    middle = Pose.planar((STRUT_VISIBLE_M - inner) / 2 - GRASP_OUTSIDE_M, 0.0)
    return [Part("box", size, X_OS.compose(middle), STEEL, Touch.STRUT) for X_OS in struts]


def _handle(load: Load) -> list[Part]:
    """A bar along x over the middle of the load, on two posts."""
    height = load.size_m[2]
    post = HANDLE_ABOVE_M - STRUT_SIDE_M / 2
    bar = Part(
        "box",
        (HANDLE_LENGTH_M, STRUT_SIDE_M, STRUT_SIDE_M),
        Pose.planar(0, 0, height + HANDLE_ABOVE_M),
        STEEL,
        Touch.STRUT,
    )
    x = (HANDLE_LENGTH_M - STRUT_SIDE_M) / 2
    posts = [
        Part("box", (STRUT_SIDE_M, STRUT_SIDE_M, post), Pose.planar(s * x, 0, height + post / 2), STEEL, Touch.STRUT)
        for s in (1, -1)
    ]
    return [bar, *posts]
