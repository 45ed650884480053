"""A way by places: the leader pulls to each until the load has come near, then to the next."""

from __future__ import annotations

import math

Place = tuple[float, float]
NEAR_M = 0.15
"""From where on a place counts as reached, unless told otherwise."""


class Waypoints:
    """How far on its way the load has come, by what the leader has seen.

    The same views give the same way. A simulator that was killed goes on from a moment before: a place that was reached
    later than a view is not reached yet in it.

    Args:
        places: in the world's plane, m, in this order.
        near_m: from where on a place counts as reached, m.
    """

    def __init__(self, places: tuple[Place, ...], near_m: float) -> None:
        self._places, self._near_m = places, near_m
        self._reached_ns: list[int] = []
        """Simulated time at which each of the first places was reached."""

    def next_place(self, time_ns: int, load: Place) -> Place | None:
        """Where to pull at this simulated time with the load there; None when all places have been reached.

        Args:
            time_ns: simulated time.
            load: the load's frame O in the world's plane, m.
        """
        while self._reached_ns and self._reached_ns[-1] > time_ns:
            self._reached_ns.pop()
        while (place := self._place()) is not None and math.dist(place, load) <= self._near_m:
            self._reached_ns.append(time_ns)
        return place

    def _place(self) -> Place | None:
        number = len(self._reached_ns)
        return self._places[number] if number < len(self._places) else None
