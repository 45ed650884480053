"""A process whose control loop stands still while its other threads go on: by the kernel's ptrace (Linux).

A signal stops all of a process. A law that never comes back leaves the other threads alone; so does a thread that is
traced and interrupted. It knows nothing of it. One thread of the launcher must do all of this: the kernel takes no
orders from another. Should the launcher die, the loop goes on.
"""

from __future__ import annotations

import ctypes
import os
import time
from pathlib import Path

from agents.thread_name import CONTROL
from deploy.starving import state_of

PTRACE_DETACH, PTRACE_SEIZE, PTRACE_INTERRUPT = 17, 0x4206, 0x4207
WALL = 0x40000000
"""Of waitpid: threads, too."""
TRACED = "t"
"""The kernel's letter for a thread that its tracer has stopped."""
POLL_S = 0.002


class CannotHang(OSError):
    """The kernel does not let this process do that."""


def hang(pid: int, patience_s: float) -> None:
    """Make the control loop of a child stand still, and wait until the kernel says so. Raises :class:`CannotHang`."""
    deadline = time.monotonic() + patience_s
    for thread in control_threads(pid):
        _ptrace(PTRACE_SEIZE, thread)
        _ptrace(PTRACE_INTERRUPT, thread)
        while not _has_stopped(pid, thread):
            if time.monotonic() > deadline:
                raise CannotHang(f"the kernel has not stopped it within {patience_s:g} s")
            time.sleep(POLL_S)


def _has_stopped(pid: int, thread: int) -> bool:
    found, status = os.waitpid(thread, WALL | os.WNOHANG)
    return found == thread and os.WIFSTOPPED(status) and state_of(pid, thread) == TRACED


def is_hung(pid: int) -> bool:
    """Whether its control loop is stopped by a tracer."""
    return any(state_of(pid, thread) == TRACED for thread in control_threads(pid))


def let_go(pid: int) -> None:
    """It goes on where it stood. Raises :class:`CannotHang`, also for one that has ended meanwhile."""
    for thread in control_threads(pid):
        _ptrace(PTRACE_DETACH, thread)


def control_threads(pid: int) -> list[int]:
    """The threads that work out an agent's answers: those that call themselves so, or else the process's first one.
    Linux."""
    tasks = Path(f"/proc/{pid}/task")
    named = [int(task.name) for task in tasks.glob("*") if _name_of(task) == CONTROL]
    return named or [pid]


def _name_of(task: Path) -> str:
    try:
        return (task / "comm").read_text(encoding="utf-8").strip()
    except OSError:
        return ""


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
