"""Where a dashboard is shown: a picture on a terminal, or lines where there is none."""

from __future__ import annotations

import os
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from deploy.see.watch.arrangement import dashboard
from deploy.see.watch.canvas import ASCII, FANCY, Glyphs
from deploy.see.watch.panels import WELL, number, printable
from deploy.see.watch.seen import Seen
from deploy.see.watch.top_view import Told

LINE_EVERY_S = 1.0
"""Simulated time between two lines of progress."""
FAREWELL_LINES = 2
"""Lines that the prompt and the last sentence need below the last picture."""


def glyphs_for(console: Console, *, ascii_only: bool) -> Glyphs:
    """Braille and blocks where the output can say them."""
    return ASCII if ascii_only or not console.encoding.lower().startswith("utf") else FANCY


class Picture:
    """The dashboard on the terminal's second screen; the first is as it was when that is left."""

    def __init__(self, console: Console, glyphs: Glyphs, told: Told) -> None:
        self._console, self._glyphs, self._told = console, glyphs, told
        self._live = Live(
            console=console, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
        )
        self._last: tuple[tuple[int, int], Text] | None = None

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def show(self, seen: Seen, warning: str) -> None:
        """Draw it anew, if it looks different."""
        width, height = self._console.size
        picture = ((width, height), self._draw(seen, width, height, warning))
        if picture != self._last:
            self._last = picture
            self._live.update(picture[1], refresh=True)

    def leave_behind(self, seen: Seen) -> None:
        """Print the picture where it stays; for when the second screen has been left."""
        width, height = self._console.size
        self._console.print(self._draw(seen, width, height - FAREWELL_LINES, ""))

    def _draw(self, seen: Seen, width: int, height: int, warning: str) -> Text:
        lines = dashboard(seen, width, height, self._glyphs, self._told, warning)
        picture = Text("\n", no_wrap=True, overflow="crop", end="").join(lines)
        picture.no_wrap, picture.overflow = True, "crop"
        return picture


class Lines:
    """Every event as a line, and how far it is once a simulated second: for a pipe, a log, or a screen reader."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._happened, self._next_s, self._said = 0, 0.0, ""

    def show(self, seen: Seen, warning: str) -> None:
        """Print what is new."""
        new = seen.happened - self._happened
        for each in seen.happenings[-new:] if new > 0 else ():
            self._print(f"{each.time_s:.2f} s: {printable(each.text)}")
        self._happened = seen.happened
        if seen.phase == "waiting" and seen.progress is not None:
            self._say(f"waiting for {printable(seen.progress.waiting_for)}")
        elif seen.phase == "running" and seen.time_s >= self._next_s:
            self._next_s = LINE_EVERY_S * (seen.time_s // LINE_EVERY_S + 1)
            self._print(sentence(seen))
        if warning:
            self._say(warning.partition(",")[0])

    def _say(self, text: str) -> None:
        """What holds for some time is said once."""
        if text != self._said:
            self._said = text
            self._print(text)

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, markup=False, highlight=False, style=None)


def sentence(seen: Seen) -> str:
    """How far a run is, in one line."""
    parts = [f"{seen.time_s:.2f} s: tick {seen.tick}"]
    if seen.progress is not None:
        parts[0] += f" of {seen.progress.ticks}"
        parts.append(f"tilt {number(seen.progress.tilt_deg, 2, 'deg')}")
        if seen.progress.goal_distance_m >= 0:
            parts.append(f"{number(seen.progress.goal_distance_m, 2, 'm')} to the goal")
    parts += [f"{name} {state}" for name in seen.arm_names if (state := seen.state_of(name)) not in WELL]
    return ", ".join(parts)


def why_plain(console: Console) -> str:
    """Why only lines can be printed; empty where there can be a picture."""
    if not console.is_terminal:
        return "standard output is no terminal"
    return f"TERM={os.environ.get('TERM', '')} has no cursor to move" if console.is_dumb_terminal else ""
