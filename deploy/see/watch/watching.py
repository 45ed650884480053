"""``palanquin watch``: from an open link to a sentence about how it ended."""

from __future__ import annotations

import errno
import os
import sys

from rich.console import Console

from deploy.exit_status import COULD_NOT_RUN, OF_VERDICT
from deploy.see.heard import YIELDS
from deploy.see.watch.panels import printable
from deploy.see.watch.screens import Lines, Picture, glyphs_for, why_plain
from deploy.see.watch.seen import Seen
from deploy.see.watch.top_view import NOTHING_TOLD, Told
from deploy.see.watch.watcher import Watcher
from sim_server.scenario import Scenario


def told_by(scenario: Scenario | None) -> Told:
    """What the scenario says of what is seen from above."""
    if scenario is None:
        return NOTHING_TOLD
    length, width, _ = scenario.load.size_m
    return Told((length, width), scenario.leader.goal_m if scenario.leader is not None else None)


def watch_run(
    watcher: Watcher,
    console: Console,
    told: Told,
    *,
    reconnect_s: float,
    plain: bool = False,
    ascii_only: bool = False,
    says_farewell: bool = True,
) -> int:
    """Show a run until it has ended; the exit status, which is that of its verdict.

    Args:
        told: what the scenario says, if it is known.
        reconnect_s: as :meth:`Watcher.run_to_end`.
        says_farewell: leave the last picture and a sentence behind.

    Raises:
        NotSeen: the simulator has gone.
    """
    os.nice(YIELDS)
    lack = why_plain(console)
    if lack and not plain:
        print(f"palanquin: {lack}: a line for every event and every simulated second", file=sys.stderr)
    picture = None if lack or plain else Picture(console, glyphs_for(console, ascii_only=ascii_only), told)
    try:
        seen = _shown(watcher, picture, console, reconnect_s, leaves_picture=says_farewell)
        if says_farewell:
            console.print(last_sentence(seen, stopped=watcher.was_stopped), soft_wrap=True, markup=False)
    except OSError as error:
        if error.errno != errno.EIO:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return COULD_NOT_RUN  # the terminal is gone, and whoever looked at it
    return exit_status(seen, stopped=watcher.was_stopped)


def _shown(
    watcher: Watcher, picture: Picture | None, console: Console, reconnect_s: float, *, leaves_picture: bool
) -> Seen:
    if picture is None:
        return watcher.run_to_end(Lines(console), reconnect_s)
    try:
        with picture:
            return watcher.run_to_end(picture, reconnect_s)
    finally:
        if leaves_picture:
            picture.leave_behind(watcher.seen)


def last_sentence(seen: Seen, *, stopped: bool) -> str:
    """How it ended."""
    if seen.ended is not None:
        return f"{seen.verdict or 'ended, and no verdict was told'}: {printable(seen.ended)}"
    if not stopped or seen.phase == "unheard":
        return "stopped before anything was heard of the run" if stopped else ""
    return f"stopped watching at {seen.time_s:.2f} s; the run goes on"


def exit_status(seen: Seen, *, stopped: bool) -> int:
    """0 holds, 1 violated, 3 nobody knows; 0 too for who looks away before the end."""
    if seen.ended is None and stopped:
        return 0
    return OF_VERDICT.get(seen.verdict, COULD_NOT_RUN)
