"""Somebody who listens to a person: starts the process that reads the device, and hands on what it says."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Literal

from deploy.exit_status import BAD_INPUT
from deploy.person import gamepad, keys
from deploy.person.__main__ import CANNOT, READY

Device = Literal["keyboard", "gamepad"]
HELP = {"keyboard": keys.HELP, "gamepad": gamepad.HELP}
"""What a person can do with each."""
END_S = 2.0
"""Time that the process gets to put the terminal right."""


class CannotAttend(Exception):
    """The device, or what reads it, is not there."""

    exit_status = BAD_INPUT


class Attended:
    """A person at a device of this machine, heard over a socket: who closes it wakes both its ends."""

    def __init__(self, line: socket.socket) -> None:
        self._line, self._said = line, line.makefile("rb")
        self._is_over = threading.Event()

    def first_line(self) -> bytes:
        """What the process says when it is ready, or cannot be."""
        return self._said.readline().strip()

    def hand_on(self, hear: Callable[[bytes], object], at_end: Callable[[], object]) -> None:
        """From now on give each line to ``hear``, on a thread of its own; and call ``at_end`` if the person goes."""

        def listen() -> None:
            for line in self._said:
                hear(line)
            if not self._is_over.is_set():
                at_end()

        threading.Thread(target=listen, name="person", daemon=True).start()

    def hang_up(self) -> None:
        """Listen no longer; the process notices, and ends."""
        self._is_over.set()
        with suppress(OSError):  # it has gone
            self._line.shutdown(socket.SHUT_RDWR)


@contextmanager
def attended(device: Device) -> Iterator[Attended]:
    """A person at this device. The process that reads it stays outside of any walls that this one raises meanwhile, and
    ends with it.

    Raises:
        CannotAttend: it is not there, with the reason.
    """
    ours, theirs = socket.socketpair()
    with ours:
        with theirs:
            process = _start(device, theirs)
        person = Attended(ours)
        try:
            first = person.first_line()
            if first != READY:
                died = f"--{device}: the process that reads it has ended; it said {first!r}"
                raise CannotAttend(first.removeprefix(CANNOT).decode() if first.startswith(CANNOT) else died)
            yield person
        finally:
            person.hang_up()
            try:
                process.wait(END_S)  # then the terminal is as it was
            except subprocess.TimeoutExpired:
                with suppress(PermissionError):  # inside walls nobody else is reached
                    process.kill()


def _start(device: Device, line: socket.socket) -> subprocess.Popen[bytes]:
    """In this process's own group, or the terminal would not let it read. Ctrl-C is not for it, from the beginning."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        return subprocess.Popen([sys.executable, "-m", "deploy.person", device], stdout=line.fileno())
    finally:
        signal.signal(signal.SIGINT, before)
