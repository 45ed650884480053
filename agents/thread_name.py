"""Names of threads as the operating system shows them (``top -H``), and as whoever looks for one of them finds it."""

from __future__ import annotations

import ctypes
import sys
import threading

CONTROL = "control"
"""The thread that works out an agent's answers, where that is not its process's first one."""
_PR_SET_NAME = 15


def name_this_thread(name: str) -> None:
    """Name it, on Linux. Never a process's first thread, whose name is the process's."""
    if sys.platform == "linux" and threading.current_thread() is not threading.main_thread():
        ctypes.CDLL(None).prctl(_PR_SET_NAME, name.encode(), 0, 0, 0)
