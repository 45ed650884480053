"""A terminal that gives every key at once and shows none, and is as it was before when that is over."""

from __future__ import annotations

import os
import signal
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

LOCAL, CONTROL = 3, 6
"""Places in what :func:`termios.tcgetattr` gives."""


@contextmanager
def each_key(terminal: int) -> Iterator[None]:
    """Read keys one by one from this descriptor meanwhile. Ctrl-C stays what it is; Ctrl-Z does nothing: it would stop
    the person, and not the pull.

    Raises:
        termios.error: it is no terminal.
    """
    before = termios.tcgetattr(terminal)
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # to put it right also when somebody else is in the foreground
    try:
        termios.tcsetattr(terminal, termios.TCSANOW, _each_key(before, terminal))
        yield
    finally:
        with suppress(termios.error):  # it has gone
            termios.tcflush(terminal, termios.TCIFLUSH)  # keys that nobody has taken are for nobody else
            termios.tcsetattr(terminal, termios.TCSANOW, before)


def _each_key(before: list[Any], terminal: int) -> list[Any]:
    attributes = [*before[:CONTROL], list(before[CONTROL])]
    attributes[LOCAL] &= ~(termios.ICANON | termios.ECHO)
    attributes[CONTROL][termios.VMIN], attributes[CONTROL][termios.VTIME] = 1, 0
    attributes[CONTROL][termios.VSUSP] = bytes([os.fpathconf(terminal, "PC_VDISABLE") & 0xFF])
    return attributes
