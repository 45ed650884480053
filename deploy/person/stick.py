"""What a gamepad's stick means: two axes in, a wish out."""

from __future__ import annotations

import math

from agents.wish import Wish

DEAD = 0.15
"""Part of the stick's way from its middle in which it counts as untouched: sticks do not come back quite to it."""
FINENESS = 64
"""Steps of each part of the pull: a stick that trembles is no new wish."""


def stick_wish(right: float, down: float, *, brake: bool = False, leave: bool = False) -> Wish:
    """The wish of a stick pushed so far, each -1 to 1, as gamepads count: forward is ahead (+x), left is left (+y).

    The pull grows from nothing at the edge of the dead zone to the largest at the stick's end, in the stick's very
    direction. An axis that gives no number counts as untouched.
    """
    if brake or leave:
        return Wish(brake=brake and not leave, leave=leave)
    if not (math.isfinite(right) and math.isfinite(down)):
        return Wish()
    pushed = math.hypot(right, down)
    if pushed <= DEAD:
        return Wish()
    part = (min(pushed, 1.0) - DEAD) / (1.0 - DEAD)
    return Wish((_rounded(-down / pushed * part), _rounded(-right / pushed * part)))


def _rounded(part: float) -> float:
    return round(part * FINENESS) / FINENESS + 0.0  # no negative zero
