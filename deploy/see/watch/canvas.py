"""A small drawing of dots and letters: braille, two by four dots a letter, or plain ASCII."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rich.text import Text

ACROSS, DOWN = 2, 4
"""Dots of a letter. They lie as far apart in both directions: a letter is about twice as high as wide."""
_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_BRAILLE = 0x2800


@dataclass(frozen=True, slots=True)
class Glyphs:
    """What bars and drawings are made of."""

    full: str
    parts: str
    """A letter that is filled in part, from little to much; may be none."""
    empty: str
    mark: str
    rule: str
    more: str
    """Stands for what does not fit in a line."""
    levels: str
    """From low to high."""
    braille: bool


FANCY = Glyphs("█", "▏▎▍▌▋▊▉", "░", "┃", "─", "…", "▁▂▃▄▅▆▇█", True)
ASCII = Glyphs("#", "", ".", "|", "-", "~", "_.-=+*%#", False)


class Canvas:
    """Letters of ``width`` by ``height``; dots count from the upper left corner."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._bits = [[0] * width for _ in range(height)]
        self._styles = [[""] * width for _ in range(height)]
        self._letters = [[""] * width for _ in range(height)]

    def dot(self, x: float, y: float, style: str = "") -> None:
        """One dot; nothing outside of the canvas."""
        across, down = math.floor(x), math.floor(y)
        if 0 <= across < ACROSS * self.width and 0 <= down < DOWN * self.height:
            column, row = across // ACROSS, down // DOWN
            self._bits[row][column] |= _BITS[down % DOWN][across % ACROSS]
            self._styles[row][column] = style

    def line(self, start: tuple[float, float], end: tuple[float, float], style: str = "") -> None:
        """A straight line of dots."""
        steps = max(1, math.ceil(max(abs(end[0] - start[0]), abs(end[1] - start[1]))))
        for k in range(steps + 1):
            part = k / steps
            self.dot(start[0] + part * (end[0] - start[0]), start[1] + part * (end[1] - start[1]), style)

    def word(self, x: float, y: float, text: str, style: str = "") -> None:
        """A word whose middle is at a dot, over whatever is there; moved so that it is whole at the canvas's edge."""
        row = math.floor(y) // DOWN
        first = min(max(0, math.floor(x) // ACROSS - (len(text) - 1) // 2), max(0, self.width - len(text)))
        if not 0 <= row < self.height:
            return
        for column, letter in zip(range(first, self.width), text, strict=False):
            self._letters[row][column] = letter
            self._styles[row][column] = style

    def draw(self, glyphs: Glyphs) -> list[Text]:
        """The lines, each ``width`` letters wide."""
        lines = []
        for bits, letters, styles in zip(self._bits, self._letters, self._styles, strict=True):
            line = Text()
            for dots, letter, style in zip(bits, letters, styles, strict=True):
                line.append(letter or _letter(dots, glyphs), style)
            lines.append(line)
        return lines


def _letter(dots: int, glyphs: Glyphs) -> str:
    if not dots:
        return " "
    if glyphs.braille:
        return chr(_BRAILLE | dots)
    return "*" if dots.bit_count() > 1 else "."
