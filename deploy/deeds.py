"""Deeds done for a scenario's events: kill, stop, continue and start, each confirmed; and leave, which takes an agent
simulated time and is therefore only asked for. Here to processes of this machine; deploy/docker_engine.py does them to
containers."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import time
from collections.abc import Callable

from wire.codec import decode, encode
from wire.keys import Keys
from wire.link import Link
from wire.messages import Deed, Done

CONFIRM_S = 15.0
"""Time that the kernel gets."""
POLL_S = 0.002

Find = Callable[[str], "subprocess.Popen[bytes] | None"]


class Doer:
    """Has done what the simulator asks for and reports it.

    Args:
        link: the operator's.
        run: name of the run.
        do: does a deed, and tells what was in the way, or nothing.
    """

    def __init__(self, link: Link, run: str, do: Callable[[Deed], str]) -> None:
        keys = Keys(run)
        self._do = do
        self._asked: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._report = link.publisher(keys.order)
        link.subscribe(keys.deeds, self._asked.put)

    def do_for(self, seconds: float) -> None:
        """Do everything that is asked for within this time; returns when it is over."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            try:
                deed = decode(self._asked.get(timeout=left), Deed)
            except queue.Empty:
                return
            self._report.put(encode(Done(deed.number, self._do(deed))))


class Processes:
    """The agents' processes, children of this one.

    Args:
        find: the process of an agent.
        start: starts an agent's process anew.
    """

    def __init__(self, find: Find, start: Callable[[str], None]) -> None:
        self._find, self._start = find, start

    def do(self, deed: Deed) -> str:
        """Do it; what was in the way, or nothing."""
        process = self._find(deed.agent)
        if deed.verb == "start":
            if process is not None and process.poll() is None:
                process.kill()
                process.wait(CONFIRM_S)
            try:
                self._start(deed.agent)
            except (OSError, LookupError) as error:
                return f"no process could be started: {error}"
            return ""
        if process is None or process.poll() is not None:
            return "its process has ended already"
        number = {
            "kill": signal.SIGKILL,
            "stop": signal.SIGSTOP,
            "continue": signal.SIGCONT,
            "leave": signal.SIGTERM,
        }[deed.verb]
        process.send_signal(number)
        if deed.verb == "leave":
            return ""
        if deed.verb in ("stop", "continue"):
            return _changed(process.pid, os.WSTOPPED if deed.verb == "stop" else os.WCONTINUED)
        try:
            process.wait(CONFIRM_S)
        except subprocess.TimeoutExpired:
            return f"it has not ended {CONFIRM_S:g} s after {number.name}"
        return ""


def _changed(pid: int, options: int) -> str:
    """Wait until the kernel says that all of a child has stopped, or goes on."""
    deadline = time.monotonic() + CONFIRM_S
    while time.monotonic() < deadline:
        if os.waitid(os.P_PID, pid, options | os.WNOHANG) is not None:
            return ""
        time.sleep(POLL_S)
    return f"the kernel has not confirmed it in {CONFIRM_S:g} s"
