"""Where the panels stand: side by side on a wide terminal, below each other on a narrow one, never taller than it."""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text

from deploy.see.watch.canvas import Glyphs
from deploy.see.watch.panels import arms_table, event_list, fitted, head, tilt_gauge, titled
from deploy.see.watch.seen import Seen
from deploy.see.watch.top_view import NOTHING_TOLD, Told, top_view

WIDE = 72
"""Columns from which on the top view stands beside the arms."""
TABLE_PART, WIDEST_TABLE = 0.58, 64
GAP = 2
LEAST_EVENTS, LEAST_VIEW, MOST_VIEW, SHORT_GAUGE = 3, 6, 18, 2
"""Lines."""


def dashboard(
    seen: Seen, width: int, height: int, glyphs: Glyphs, told: Told = NOTHING_TOLD, warning: str = ""
) -> list[Text]:
    """The whole picture: at most ``height`` lines of at most ``width`` cells.

    Args:
        told: what the scenario says, if it is known.
        warning: what is wrong with the connection, if anything is.
    """
    top = head(seen, width, glyphs, warning)
    room = max(0, height - len(top) - 1 - LEAST_EVENTS)  # the events' title is a line
    middle = _beside(seen, width, room, glyphs, told) if width >= WIDE else _below(seen, width, room, glyphs, told)
    left = height - len(top) - len(middle)
    below = [titled("events", width, glyphs), *event_list(seen, width, left - 1, glyphs)] if left > 0 else []
    return [fitted(line, width, glyphs) for line in [*top, *middle, *below][: max(0, height)]]


def _beside(seen: Seen, width: int, room: int, glyphs: Glyphs, told: Told) -> list[Text]:
    table_width = min(WIDEST_TABLE, round(TABLE_PART * width))
    gauge = _gauge(seen, table_width, room, glyphs)
    arms = arms_table(seen, table_width, glyphs, max(2, room - len(gauge)))
    left = [*arms, *gauge][:room]
    if len(left) < room:
        left.insert(len(arms), Text())
    lines = min(room, max(len(left), LEAST_VIEW, min(MOST_VIEW, room - LEAST_EVENTS)))
    right = top_view(seen, width - table_width - GAP, lines, glyphs, told)
    return _side_by_side(left, right, table_width + GAP)


def _below(seen: Seen, width: int, room: int, glyphs: Glyphs, told: Told) -> list[Text]:
    gauge = _gauge(seen, width, room, glyphs)
    arms = arms_table(seen, width, glyphs, max(2, room - len(gauge)))
    lines = [*arms, *gauge][:room]
    rest = room - len(lines)
    return [*lines, *top_view(seen, width, min(MOST_VIEW, rest), glyphs, told)] if rest >= LEAST_VIEW else lines


def _gauge(seen: Seen, width: int, room: int, glyphs: Glyphs) -> list[Text]:
    """The tilt; two lines of it where the arms need the others."""
    gauge = tilt_gauge(seen, width, glyphs)
    return gauge if 1 + len(seen.arm_names) + len(gauge) <= room else gauge[:SHORT_GAUGE]


def _side_by_side(left: Sequence[Text], right: Sequence[Text], column: int) -> list[Text]:
    """Lines of both, the right ones from ``column`` on."""
    lines = []
    for k in range(max(len(left), len(right))):
        line = left[k] if k < len(left) else Text()
        line = line + Text(" " * (column - line.cell_len))
        lines.append(line + right[k] if k < len(right) else line)
    return lines
