"""Deeds done for a scenario's events: kill, stop, hang, slow, continue, start, disconnect, reconnect, each confirmed.

And leave, which takes an agent simulated time and is therefore only asked for. Here to processes of this machine;
deploy/docker_engine.py does them to containers.
"""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from deploy.hanging import CannotHang, hang, is_hung, let_go
from deploy.relay import Relay
from deploy.starving import Starved
from sim_server.process_deeds import SIM
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
        do: does a deed, and tells what was in the way, or nothing; None if nobody is left who would hear it.
    """

    def __init__(self, link: Link, run: str, do: Callable[[Deed], str | None]) -> None:
        keys = Keys(run)
        self._do = do
        self.was_asked = False
        """Whether the simulator has asked for anything: then its ticks have begun."""
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
            self.was_asked = True
            problem = self._do(deed)
            if problem is not None:
                self._report.put(encode(Done(deed.number, problem)))


class Processes:
    """The agents' processes, children of this one.

    Args:
        find: the process of an agent.
        start: starts an agent's process anew.
        restart_sim: kills the simulator and starts it again from its last checkpoint; what was in the way.
        shares: for each ``slow`` of the scenario, in order of time, the agent and its part of the time, 0 to 1.
        relays: by agent, those that stand in the links that the scenario cuts.
    """

    def __init__(
        self,
        find: Find,
        start: Callable[[str], None],
        restart_sim: Callable[[], str],
        shares: Iterable[tuple[str, float]] = (),
        relays: Mapping[str, Relay] = MappingProxyType({}),
    ) -> None:
        self._find, self._start, self._restart_sim = find, start, restart_sim
        self._shares, self._relays = list(shares), relays
        self._starved: dict[str, Starved] = {}

    def do(self, deed: Deed) -> str | None:
        """Do it; what was in the way, or nothing. None if the simulator is no more: who asked for its own death does
        not hear of it."""
        if deed.agent == SIM:
            return self._restart_sim() or None
        process = self._find(deed.agent)
        if deed.agent in self._starved:
            self._starved.pop(deed.agent).end()
            if deed.verb == "continue":
                return ""
        if deed.verb == "start":
            if deed.agent in self._relays:
                self._relays[deed.agent].restore()
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
        if deed.verb == "slow":
            return self._slow(deed.agent, process)
        if deed.verb in ("disconnect", "reconnect"):
            return self._link(deed)
        try:
            if deed.verb == "hang":
                hang(process.pid, CONFIRM_S)
                return ""
            if deed.verb == "continue" and is_hung(process.pid):
                let_go(process.pid)
                return ""
        except CannotHang as error:
            return f"its control loop cannot be stopped or let go: {error}"
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

    def _link(self, deed: Deed) -> str:
        relay = self._relays.get(deed.agent)
        if relay is None:
            return "nothing stands in its link that could cut it"
        if deed.verb == "reconnect":
            relay.restore()
            return ""
        return "" if relay.cut() else "it has no link that could be cut"

    def _slow(self, agent: str, process: subprocess.Popen[bytes]) -> str:
        share = next((each for each in self._shares if each[0] == agent), None)
        if share is None:
            return "the scenario says nothing of its share of the time"
        self._shares.remove(share)
        self._starved[agent] = Starved(process, share[1])
        if not self._starved[agent].is_seen(CONFIRM_S):
            return f"the kernel has not shown it stopped and going on in {CONFIRM_S:g} s"
        return ""

    def end(self) -> None:
        """Nobody is starved any more, so that all can obey a signal."""
        while self._starved:
            self._starved.popitem()[1].end()


def _changed(pid: int, options: int) -> str:
    """Wait until the kernel says that all of a child has stopped, or goes on."""
    deadline = time.monotonic() + CONFIRM_S
    while time.monotonic() < deadline:
        if os.waitid(os.P_PID, pid, options | os.WNOHANG) is not None:
            return ""
        time.sleep(POLL_S)
    return f"the kernel has not confirmed it in {CONFIRM_S:g} s"
