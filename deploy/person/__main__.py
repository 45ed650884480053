"""The process that reads a person's device: ``python -m deploy.person keyboard`` (or ``gamepad``).

It prints ``ready``, or ``cannot`` and why; then each wish as a line (:mod:`agents.wish`). It ends after ``leave``, when
the device has gone, when it is told to by a signal, or when nobody reads its lines any more, however that one ended: so
the terminal is put right even if the leader is killed. It stands outside the leader's walls, and is no part of them.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Iterable

from agents.wish import Wish
from deploy.person.gamepad import NoGamepad, wishes
from deploy.person.keys import Keys
from deploy.person.terminal import each_key

READY, CANNOT = b"ready", b"cannot "
"""How the first line begins."""
NO_TERMINAL = "--keyboard: standard input is no terminal; expected one, whose keys lead"
IN, OUT = 0, 1


def main(device: str) -> None:
    """Read it until one of the ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for those who read, and then they end
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: sys.exit(0))
    try:
        {"keyboard": _keyboard, "gamepad": _gamepad}[device]()
    except NoGamepad as problem:
        _say(CANNOT + str(problem).encode())
    except BrokenPipeError:
        pass


def _keyboard() -> None:
    if not os.isatty(IN):
        _say(CANNOT + NO_TERMINAL.encode())
        return
    keys = Keys()
    with each_key(IN):
        _say(READY)
        while True:
            ready = _wait(IN)
            if not ready:
                return
            try:
                typed = os.read(IN, 1024)
            except OSError:  # the terminal has gone
                return
            if not typed or _say_all(keys.typed(typed)):
                return


def _wait(device: int) -> bool:
    """Until there is something to read; False when nobody reads what is said."""
    poll = select.poll()
    poll.register(device, select.POLLIN)
    poll.register(OUT, 0)  # an end that nobody reads from tells so without being asked
    return all(which != OUT for which, _ in poll.poll())


def _gamepad() -> None:
    looks = wishes()
    next(looks)
    _say(READY)
    for wish in looks:
        if _say_all([wish] if wish else []) or _nobody_reads():
            return


def _nobody_reads() -> bool:
    poll = select.poll()
    poll.register(OUT, 0)
    return bool(poll.poll(0))


def _say(line: bytes) -> None:
    os.write(OUT, line + b"\n")


def _say_all(new: Iterable[Wish]) -> bool:
    """Whether the last of them is to leave."""
    for wish in new:
        os.write(OUT, wish.line())
        if wish.leave:
            return True
    return False


if __name__ == "__main__":
    main(sys.argv[1])
