"""A pseudo terminal for tests: somebody who types, and sees what is shown."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from processes import PATIENCE_S, wait_until


class Terminal:
    """One that a command runs in, as its controlling terminal: Ctrl-C typed here is a signal there."""

    def __init__(self) -> None:
        self.ours, self.theirs = pty.openpty()
        fcntl.ioctl(self.theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 200, 0, 0))
        self.before = self.modes()
        self._shown = bytearray()
        self.is_closed = False
        self._until, self._enough = os.pipe()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def _watch(self) -> None:
        """Not in a read that waits: as long as one does, a closed terminal is not gone."""
        with suppress(OSError):  # nobody has it open any more
            while self._until not in select.select([self.ours, self._until], [], [])[0]:
                self._shown += os.read(self.ours, 65536)

    def close(self) -> None:
        """The window is closed; once more is nothing."""
        if self.is_closed:
            return
        self.is_closed = True
        os.close(self._enough)
        self._watcher.join(10)
        for descriptor in (self._until, self.ours, self.theirs):
            os.close(descriptor)

    def modes(self) -> list[Any]:
        """As :func:`termios.tcgetattr`."""
        return termios.tcgetattr(self.theirs)

    @property
    def is_as_before(self) -> bool:
        return self.modes() == self.before

    @property
    def gives_each_key(self) -> bool:
        return not self.modes()[3] & (termios.ICANON | termios.ECHO)

    def shown(self) -> str:
        """All that was shown so far."""
        return self._shown.decode(errors="replace")

    def type(self, keys: bytes) -> None:
        os.write(self.ours, keys)

    def wait_for(self, text: str, deadline_s: float = PATIENCE_S) -> None:
        """Until it is shown; with all that was shown if it is not."""
        try:
            wait_until(lambda: text in self.shown(), f"the terminal to show {text!r}", deadline_s)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.shown()[-3000:]}") from None


@contextmanager
def typed_into(command: Sequence[str | Path], cwd: Path) -> Iterator[tuple[Terminal, subprocess.Popen[bytes]]]:
    """A command in a terminal of its own; it does not outlive the block, nor does who reads its keys."""
    terminal = Terminal()
    # A shell in between would be in the foreground; Python makes the terminal its own and becomes the command.
    become = (
        "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); os.execvp(sys.argv[1], sys.argv[1:])"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", become, *map(str, command)],
        cwd=cwd,
        stdin=terminal.theirs,
        stdout=terminal.theirs,
        stderr=terminal.theirs,
        start_new_session=True,
    )
    try:
        yield terminal, process
    finally:
        process.kill()
        process.wait(10)
        terminal.close()
