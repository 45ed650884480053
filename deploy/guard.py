"""No orphans: a process that was started by another ends when that other ends, and signals end things in order."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType

from deploy.exit_status import COULD_NOT_RUN

_PR_SET_PDEATHSIG = 1
HARD_EXIT_S = 20.0
"""Time that an orderly stop gets."""
GOODBYE_S = 5.0
"""Time that an agent gets to say goodbye."""


def end_with_parent(
    on_end: Callable[[], object], *, even_if_stopped: bool, hear: Callable[[bytes], object] = lambda said: None
) -> None:
    """Call ``on_end`` when standard input closes, which it does when the process that holds its other end is gone.

    Args:
        hear: is given what comes over it until then.
        even_if_stopped: also have the kernel kill this process when its parent dies (Linux): a process that is stopped
            at that moment cannot read its input. For processes that keep nothing worth saving.
    """

    def watch() -> None:
        while said := os.read(stdin, 4096):
            hear(said)
        on_end()

    stdin = sys.stdin.fileno()
    if even_if_stopped and sys.platform == "linux":
        parent = os.getppid()
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died before the kernel knew
            os._exit(1)
    threading.Thread(target=watch, name="end with parent", daemon=True).start()


class Interrupted(BaseException):
    """The user, or the system, asked the launcher to stop. Like KeyboardInterrupt no Exception: who expects that
    anything may go wrong with somebody else's code does not mean this."""

    exit_status = 3

    def __init__(self, by: str) -> None:
        super().__init__(f"stopped by {by}")


def raise_on_signals() -> None:
    """Turn Ctrl-C, SIGTERM and a closed terminal into :class:`Interrupted`: the first asks for an orderly end, the
    second for an end at once; further ones do not disturb the cleaning up."""
    came = 0

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came += 1
        if came <= 2:
            raise Interrupted(signal.Signals(number).name)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Whoever asks the process to end, by whichever signal, asks it to stop in order."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop())


def leave_on_signals(leave: Callable[[], bool] = lambda: False) -> None:
    """Let an agent that is told to go do so: Ctrl-C is KeyboardInterrupt, at which it says goodbye at once; SIGTERM
    asks it to ``leave`` in order, and is the same as Ctrl-C if that is False. An agent whose law does not come back
    can say nothing, and is ended after a while."""

    def on_int(number: int, frame: FrameType | None) -> None:
        _exit_later(GOODBYE_S)
        signal.default_int_handler(number, frame)

    def on_term(number: int, frame: FrameType | None) -> None:
        if not leave():
            on_int(number, frame)

    signal.signal(signal.SIGINT, on_int)
    signal.signal(signal.SIGTERM, on_term)


def stop_or_exit(stop: Callable[[], None]) -> None:
    """Stop in order; if that does not work, stop."""
    stop()
    _exit_later(HARD_EXIT_S)


def _exit_later(seconds: float) -> None:
    timer = threading.Timer(seconds, os._exit, [COULD_NOT_RUN])
    timer.daemon = True
    timer.start()
