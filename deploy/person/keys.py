"""What keys mean: bytes of a terminal in, wishes out. A terminal tells of a key that goes down, never of one that comes
up, so a key sets the pull and it stays until the next one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from agents.wish import Wish

STEPS = 10
"""The pull is so many parts of the largest one; it starts with half of them."""
ESCAPE = re.compile(rb"\x1b(?:\[[0-?]*[ -/]*[@-~]|O[@-~])")
"""What a terminal sends for a key that is no letter: CSI and SS3 sequences."""
BEGUN = re.compile(rb"\x1b(?:\[[0-?]{0,16}[ -/]{0,4}|O)?")
"""The beginning of one."""

_DIAGONAL = math.sqrt(0.5)
AHEAD, LEFT, BACK, RIGHT = (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)
DIRECTIONS = {
    **{"w": AHEAD, "a": LEFT, "s": BACK, "d": RIGHT},
    **{"8": AHEAD, "4": LEFT, "2": BACK, "6": RIGHT},
    **{"7": (_DIAGONAL, _DIAGONAL), "9": (_DIAGONAL, -_DIAGONAL)},
    **{"1": (-_DIAGONAL, _DIAGONAL), "3": (-_DIAGONAL, -_DIAGONAL)},
}
"""Unit vectors in the world's plane; digits lie as on a keypad."""
ARROWS = {"A": AHEAD, "B": BACK, "C": RIGHT, "D": LEFT}
"""By the last letter of the sequence."""
STRONGER, WEAKER, LET_GO, BRAKE, LEAVE = "+=", "-_", " 5", "b", "q"

HELP = (
    "arrows or W A S D: pull ahead, left, back, right (7 9 1 3: between them); + and -: harder, softer; "
    "space: let go; B: brake; Q: leave"
)


class Keys:
    """What a person has typed so far, as a wish."""

    def __init__(self) -> None:
        self._direction: tuple[float, float] | None = None
        self._steps = STEPS // 2
        self._wish = Wish()
        self._rest = b""

    def typed(self, data: bytes) -> Iterator[Wish]:
        """The new wish after each key that changes it. Bytes may be cut anywhere; what means nothing is passed over."""
        data, self._rest = self._rest + data, b""
        while data:
            if sequence := ESCAPE.match(data):
                key, data = sequence[0], data[sequence.end() :]
                yield from self._press_arrow(key[-1:].decode())
            elif BEGUN.fullmatch(data):
                self._rest, data = data, b""  # the next bytes say what it is
            else:
                key, data = data[:1], data[1:]
                yield from self._press(key.decode("latin-1").lower())

    def _press_arrow(self, letter: str) -> Iterator[Wish]:
        if letter in ARROWS:
            yield from self._pull(ARROWS[letter])

    def _press(self, key: str) -> Iterator[Wish]:
        if key in DIRECTIONS:
            yield from self._pull(DIRECTIONS[key])
        elif key in STRONGER or key in WEAKER:
            self._steps = min(STEPS, max(1, self._steps + (1 if key in STRONGER else -1)))
            if self._direction is not None:
                yield from self._pull(self._direction)
        elif key in LET_GO or key in (BRAKE, LEAVE):
            self._direction = None
            yield from self._want(Wish(brake=key == BRAKE, leave=key == LEAVE))

    def _pull(self, direction: tuple[float, float]) -> Iterator[Wish]:
        self._direction = direction
        part = self._steps / STEPS
        yield from self._want(Wish((part * direction[0], part * direction[1])))

    def _want(self, wish: Wish) -> Iterator[Wish]:
        if wish != self._wish:
            self._wish = wish
            yield wish
