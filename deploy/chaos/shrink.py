"""Delta debugging of a schedule: the fewest events, and then the smallest values, that still make a run fail.

A. Zeller and R. Hildebrandt, "Simplifying and isolating failure-inducing input", IEEE Transactions on Software
Engineering 28(2), 2002: the algorithm ddmin. What is a failure is asked of the caller; here nothing runs.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

from deploy.chaos.catalogue import DIGITS, WEAK_ENDS, Event

Fails = Callable[[Sequence[Event]], bool]

NOT_STRENGTHS = ("at_s", "joint", "strut")
"""Keys whose numbers are moments and names."""
HALVINGS = 4
"""Of a strength or duration: what is left is at most a sixteenth of it above the weakest that fails, if all that is
stronger fails as well."""
ALMOST_NOTHING = 1 / 64
"""Of a strength or duration, tried first: many are not what a failure needs."""


@dataclass(frozen=True, slots=True)
class Shrunk:
    """What is left of a schedule."""

    events: list[Event]
    tries: int
    """How many schedules were tried."""
    is_done: bool
    """Whether it ended by itself, and not because it had tried enough."""


class _Asked:
    """Asks each schedule once, and no more than so many; beyond that nothing fails any more."""

    def __init__(self, fails: Fails, most: int) -> None:
        self._fails, self._most = fails, most
        self._known: dict[str, bool] = {}
        self.is_exhausted = False

    def __call__(self, events: Sequence[Event]) -> bool:
        key = json.dumps(list(events), sort_keys=True)
        if key not in self._known:
            if len(self._known) >= self._most:
                self.is_exhausted = True
                return False
            self._known[key] = self._fails(events)
        return self._known[key]

    @property
    def tries(self) -> int:
        return len(self._known)


def shrink(events: Sequence[Event], fails: Fails, most: int = 100) -> Shrunk:
    """Cut a schedule down.

    Args:
        events: in order of time.
        fails: whether a run with these events fails as the whole schedule does. A schedule that cannot be (a start
            without its kill) does not fail.
        most: schedules to try, the first included.

    Raises:
        ValueError: the whole schedule does not fail.
    """
    asked, left = _Asked(fails, most), list(events)
    if not asked(left):
        raise ValueError("the whole schedule does not fail: there is nothing to shrink")
    left = fewest(left, asked)
    while True:
        weak = weakest(left, asked)
        left = fewest(weak, asked)  # what is weaker may need fewer
        if left == weak:
            return Shrunk(left, asked.tries, not asked.is_exhausted)


def fewest(events: Sequence[Event], fails: Fails) -> list[Event]:
    """A part of the events that fails, and of which none can be left out (ddmin)."""
    left, parts = list(events), 2
    if fails([]):
        return []
    while len(left) > 1:
        for rest in _without_a_part(left, parts):
            if fails(rest):
                left, parts = rest, max(parts - 1, 2)
                break
        else:
            if parts >= len(left):
                break
            parts = min(2 * parts, len(left))
    return left


def _without_a_part(events: list[Event], parts: int) -> Iterator[list[Event]]:
    """The events without each of so many parts of them."""
    ends = [round(k * len(events) / parts) for k in range(parts + 1)]
    for begin, end in pairwise(ends):
        yield events[:begin] + events[end:]


def weakest(events: Sequence[Event], fails: Fails) -> list[Event]:
    """The same events, their durations and strengths brought towards where they do nothing as far as that still fails,
    one after the other."""
    left = list(events)
    for place, event in enumerate(events):
        for key, value in event.items():
            if key not in NOT_STRENGTHS and _is_strength(value):
                weaker = partial(_with_a_part, left, place, key)
                part = _least_part(partial(_fails_with, fails, weaker))
                left = weaker(part) if part < 1.0 else left  # untouched, not even rounded
    return left


def _with_a_part(events: list[Event], place: int, key: str, part: float) -> list[Event]:
    """The events, one of them with so much of a strength."""
    weaker = events[place] | {key: _scaled(events[place][key], part, WEAK_ENDS.get(key, 0.0))}
    return [*events[:place], weaker, *events[place + 1 :]]


def _fails_with(fails: Fails, weaker: Callable[[float], list[Event]], part: float) -> bool:
    return fails(weaker(part))


def _least_part(fails: Callable[[float], bool]) -> float:
    """A small part of a strength with which it still fails."""
    if fails(ALMOST_NOTHING):
        return ALMOST_NOTHING
    low, high = ALMOST_NOTHING, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if fails(middle) else (middle, high)
    return high


def _is_strength(value: object) -> bool:
    """Whether a key's value is a number or a vector that can be made smaller."""
    if isinstance(value, list | tuple):
        return any(map(_is_strength, value))
    return isinstance(value, float | int) and not isinstance(value, bool) and value != 0


def _scaled(value: object, factor: float, weak: float) -> object:
    """So much of the way from the weak end to the value. A count stays whole, and at least one."""
    if isinstance(value, list | tuple):
        return [_scaled(each, factor, weak) for each in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return max(1, round(value * factor))
    return round(weak + factor * (value - weak), DIGITS) if isinstance(value, float) else value
