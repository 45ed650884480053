"""A process whose first thread, its control loop, stands still while all others go on: by the kernel's ptrace (Linux).

A signal stops all of a process, and then its transport shows no sign of life any more. A law that never comes back
leaves the other threads alone; so does a thread that is traced and interrupted. It knows nothing of it. One thread of
the launcher must do all of this: the kernel takes no orders from another. Should the launcher die, the loop goes on.
"""

from __future__ import annotations

import ctypes
import os
import time

from deploy.starving import state_of

PTRACE_DETACH, PTRACE_SEIZE, PTRACE_INTERRUPT = 17, 0x4206, 0x4207
WALL = 0x40000000
"""Of waitpid: threads, too."""
POLL_S = 0.002


class CannotHang(OSError):
    """The kernel does not let this process do that."""


def hang(pid: int, patience_s: float) -> None:
    """Make the first thread of a child stand still, and wait until the kernel says so. Raises :class:`CannotHang`."""
    _ptrace(PTRACE_SEIZE, pid)
    _ptrace(PTRACE_INTERRUPT, pid)
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        found, status = os.waitpid(pid, WALL | os.WNOHANG)
        if found == pid and os.WIFSTOPPED(status) and is_hung(pid):
            return
        time.sleep(POLL_S)
    raise CannotHang(f"the kernel has not stopped it within {patience_s:g} s")


def is_hung(pid: int) -> bool:
    """Whether its first thread is stopped by a tracer."""
    return state_of(pid) == "t"


def let_go(pid: int) -> None:
    """It goes on where it stood. Raises :class:`CannotHang`, also for one that has ended meanwhile."""
    _ptrace(PTRACE_DETACH, pid)


def _ptrace(request: int, pid: int) -> None:
    ptrace = getattr(ctypes.CDLL(None, use_errno=True), "ptrace", None)
    if ptrace is None or os.uname().sysname != "Linux":
        raise CannotHang("a single thread can be stopped on Linux only")
    ptrace.argtypes, ptrace.restype = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p], ctypes.c_long
    if ptrace(request, pid, None, None) == -1:
        number = ctypes.get_errno()
        raise CannotHang(
            f"ptrace: {os.strerror(number)}; expected a machine, or container, that lets a process trace its children"
        )
