"""What bodies are made of: simple shapes with a place, a colour and a contact class. No physics engine here.

Contact classes. Each class names those that it meets; all other pairs pass through each other, which costs nothing.

    class   bit  meets               why
    NOTHING  0   -                   what is only to be looked at: arm links, wheels, pedestals
    FLOOR    1   LOAD STRUT HAND     bases are planar and never touch it
    LOAD     2   FLOOR HAND BASE     top, legs, box: a base does not drive through a leg, a lost hand lies on the top
    HAND     4   FLOOR LOAD HAND     hand and finger boxes; a hand and its own fingers are one body to the engine
    BASE     8   LOAD BASE           the base's box
    STRUT   16   FLOOR               not HAND: closed fingers overlap the strut they hold, and the grasp is the weld
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np

from sim_server.layout import Array, Pose


class Touch(IntEnum):
    """Contact class of a shape; the value is its bit."""

    NOTHING = 0
    FLOOR = 1
    LOAD = 2
    HAND = 4
    BASE = 8
    STRUT = 16


MEETS: dict[Touch, int] = {
    Touch.NOTHING: 0,
    Touch.FLOOR: Touch.LOAD | Touch.STRUT | Touch.HAND,
    Touch.LOAD: Touch.FLOOR | Touch.HAND | Touch.BASE,
    Touch.HAND: Touch.FLOOR | Touch.LOAD | Touch.HAND,
    Touch.BASE: Touch.LOAD | Touch.BASE,
    Touch.STRUT: int(Touch.FLOOR),
}
"""Bits of the classes that each class meets; symmetric."""

Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Part:
    """One shape of a body.

    Attributes:
        shape: ``box`` or ``cylinder`` (along its z).
        size: box: length, width, height [m]; cylinder: diameter, diameter, length [m].
        X: pose in the body's frame.
        colour: red, green, blue, 0 to 1.
        touch: contact class.
    """

    shape: Literal["box", "cylinder"]
    size: tuple[float, float, float]
    X: Pose
    colour: Colour
    touch: Touch = Touch.NOTHING


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass [kg], centre of mass (3,) [m] in the body's frame, inertia (3, 3) [kg m^2] about it in the body's axes."""

    mass: float
    com: Array
    I: Array


def uniform_inertia(boxes: list[Part], mass: float) -> Inertia:
    """Inertia of boxes of one density with ``mass`` [kg] in all: each box's own term plus Steiner's.

    Where two boxes overlap, both count.
    """
    volume = np.array([float(np.prod(box.size)) for box in boxes])
    masses = mass * volume / volume.sum()
    com = sum((m * box.X.p for m, box in zip(masses, boxes, strict=True)), np.zeros(3)) / mass
    I = np.zeros((3, 3))
    for m, box in zip(masses, boxes, strict=True):
        squares = np.square(box.size)
        own = m / 12 * np.diag(squares.sum() - squares)
        r = box.X.p - com
        I += box.X.R @ own @ box.X.R.T + m * (r @ r * np.eye(3) - np.outer(r, r))
    return Inertia(mass, com, I)
