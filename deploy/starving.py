"""A process that gets a part of the time: a thread stops it and lets it go on, in turn, until that is enough."""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from pathlib import Path

PERIOD_S = 0.020
"""Far below the half second without a sign of life after which the transport gives a process up."""


class Starved:
    """A process that is being starved, from now on.

    Args:
        process: a child of this process.
        share: part of every period in which it may run, between 0 and 1.
    """

    def __init__(self, process: subprocess.Popen[bytes], share: float) -> None:
        self._process, self._share = process, share
        self._enough = threading.Event()
        self._thread = threading.Thread(target=self._starve, name=f"starve-{process.pid}", daemon=True)
        self._thread.start()

    def _starve(self) -> None:
        while not self._enough.is_set() and self._process.returncode is None:
            self._process.send_signal(signal.SIGSTOP)
            self._enough.wait((1.0 - self._share) * PERIOD_S)
            self._process.send_signal(signal.SIGCONT)
            self._enough.wait(self._share * PERIOD_S)

    def is_seen(self, patience_s: float) -> bool:
        """Whether the kernel shows it stopped, and going on after that, within this time."""
        deadline, wanted = time.monotonic() + patience_s, [True, False, True]
        while wanted and time.monotonic() < deadline:
            if (state_of(self._process.pid) == "T") == wanted[0]:
                wanted.pop(0)
            time.sleep(PERIOD_S / 20)
        return not wanted

    def end(self) -> None:
        """It may run all the time again."""
        self._enough.set()
        self._thread.join()


def state_of(pid: int, thread: int | None = None) -> str:
    """The kernel's letter for what a thread of a process does (its first by default); nothing if there is none."""
    try:
        stat = Path(f"/proc/{pid}/task/{thread or pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return stat.rpartition(")")[2].split()[0]
