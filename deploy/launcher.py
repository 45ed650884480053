"""The launcher: spawns a simulator, followers and a leader on this machine, watches them, and leaves none behind.

Every child has its own session (a Ctrl-C in the terminal reaches the launcher alone), a log file, and a pipe on its
standard input that closes when the launcher dies, however it dies.
"""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from deploy.agents_told import SPARE_NAMES, cut_off, everybody, follower_arguments, leader_arguments
from deploy.deeds import Doer, Processes
from deploy.mailbox import Mailbox
from deploy.person.wishes import Wishes
from deploy.relay import Relay
from deploy.room import Rooms, room_environment
from sim_server.faults.processes import SimKill, Slow
from sim_server.run_folder import LOGS, claim_logs
from sim_server.scenario import Scenario
from wire.access import Role
from wire.codec import decode, encode
from wire.credentials import STDIN, Guests, credential_line, guests_line
from wire.endpoints import parse_endpoint
from wire.keys import Keys
from wire.link import Link
from wire.messages import Order, Progress

POLL_S = 0.05
STOP_S = 15.0
"""Time that the simulator gets to end a run and write its folder."""
TERM_S = 3.0
"""Time that a process gets between the polite signal and the last one."""

RECORDER, RECORDING_NOW = "recorder", "recording"
"""Name of the observer that records, and the line that it says when it would miss nothing."""
RECORDED_S = 60.0
"""Time that it gets to write what is left."""

Show = Callable[[Progress], None]


@dataclass(slots=True)
class Child:
    """One process of the run."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def last_words(self) -> str:
        """The signal that ended it, or the last line of its log that says something."""
        status = self.process.poll()
        if status is not None and status < 0:
            return f"ended by {signal.Signals(-status).name}; its log is {self.log}"
        lines = [line.strip() for line in self.log.read_text(encoding="utf-8", errors="replace").splitlines()]
        return next((line for line in reversed(lines) if line), "its log is empty")

    def has_said(self, line: str) -> bool:
        """Whether a line of its log is just that."""
        return line in self.log.read_text(encoding="utf-8", errors="replace").splitlines()


@dataclass(frozen=True, slots=True)
class Ended:
    """How a launched run ended: the simulator's exit status, or the first thing that failed before."""

    status: int
    problem: str


class Launcher:
    """Starts and ends the processes of one run.

    Args:
        scenario_arguments: how the simulator finds the scenario (file or name, and changes).
        scenario: the same, checked.
        run: name of the run.
        endpoint: a free address for the simulator.
        folder: the run folder.
        guests: credentials of everybody. Each process is handed its own over its standard input, so that none of
            them ever is in a file, an argument or an environment that others could read.
        recorder: where an observer records to, as ``palanquin record`` is told; without, there is none.
        wishes: what a person who leads wants, for the leader's process and no other.
    """

    def __init__(
        self,
        scenario_arguments: Sequence[str],
        scenario: Scenario,
        run: str,
        endpoint: str,
        folder: Path,
        guests: Guests,
        recorder: Sequence[str] = (),
        wishes: Wishes | None = None,
    ) -> None:
        self._scenario_arguments, self._scenario = scenario_arguments, scenario
        self._run, self._endpoint, self._folder, self._guests = run, endpoint, folder, guests
        self._recorder_arguments = list(recorder)
        self._children: list[Child] = []
        self._agents: dict[str, list[str]] = {}
        self._logs = folder / LOGS
        self._rooms = Rooms()
        self._mailbox: Mailbox | None = None
        self._processes: Processes | None = None
        self._wishes = wishes or Wishes()
        self._relays: dict[str, Relay] = {}

    def start(self) -> None:
        """Spawn everybody: the simulator, a follower per arm, and the leader if the scenario has one."""
        self._logs = claim_logs(self._folder)
        common = ["--run", self._run, "--with-parent"]
        place = ["--listen", self._endpoint, "--out", str(self._folder)]
        access, secret = self._sim_access()
        self._spawn("sim", ["sim", *common, *place, *access, *self._scenario_arguments], secret)
        self.wait_until_listening()
        if self._recorder_arguments:
            self._start_recorder(common)
        follower = follower_arguments(self._scenario)
        agents = {name: ["follower", "--arm", name, *follower] for name in everybody(self._scenario)}
        if self._scenario.leader is not None:
            agents[Role.LEADER] = ["leader", *leader_arguments(self._scenario)]
        self._relays = {name: Relay(self._endpoint) for name in cut_off(self._scenario)}
        for name, arguments in agents.items():
            self._agents[str(name)] = [
                *arguments,
                *common,
                "--connect",
                self._relays[name].endpoint if name in self._relays else self._endpoint,
                "--reconnect-s",
                self._reconnect_s(),
            ]
            if name not in self._scenario.arms and name != Role.LEADER:
                continue  # it comes later
            self._start_agent(str(name))

    def _start_recorder(self, common: Sequence[str]) -> None:
        """Start it and wait until it would miss nothing, or has ended."""
        where = [*self._recorder_arguments, "--connect", self._endpoint, "--credential", STDIN]
        secret = credential_line(self._guests.of(Role.OBSERVER))
        self._spawn(RECORDER, ["record", *common, *where, *self._scenario_arguments], secret)
        child = self._children[-1]
        while self.sim.process.poll() is None and child.process.poll() is None and not child.has_said(RECORDING_NOW):
            time.sleep(POLL_S)

    def wait_for_recorder(self) -> str:
        """Until the recording is written, some time after the simulator has ended; what went wrong, if anything did."""
        child = next((each for each in self._children if each.name == RECORDER), None)
        if child is None:
            return ""
        try:
            status = child.process.wait(RECORDED_S)
        except subprocess.TimeoutExpired:
            return f"the recorder has not ended {RECORDED_S:g} s after the simulator"
        return f"the recorder: {child.last_words()}" if status else ""

    def _reconnect_s(self) -> str:
        """How long agents wait for a simulator that is gone: not at all, as without it the run is over, but where the
        scenario has it killed and started again, or cuts a link."""
        is_killed = any(isinstance(event, SimKill) for event in self._scenario.events)
        return repr(self._scenario.clock.start_timeout_s) if is_killed or self._relays else "0"

    def _restart_sim(self) -> str:
        """Kill the simulator, and have another go on from its last checkpoint. What was in the way, or nothing."""
        self.sim.process.kill()
        self.sim.process.wait(TERM_S)
        access, secret = self._sim_access()
        place = ["--resume", str(self._folder), "--listen", self._endpoint]
        try:
            self._spawn("sim", ["sim", "--run", self._run, "--with-parent", *place, *access], secret)
        except OSError as error:
            return f"no simulator could be started: {error}"
        return ""

    def _start_agent(self, name: str) -> None:
        """Start an agent's process, for the first time or again: with the same credential, in a room of its own."""
        if name not in self._agents:
            raise LookupError(f"nobody has a credential for {name}: a run has {SPARE_NAMES} for robots not foreseen")
        access, secret = self._agent_access(name)
        self._spawn(name, [*self._agents[name], *access], secret, self._rooms.make())

    def _sim_access(self) -> tuple[list[str], bytes]:
        """How the simulator learns whom to let in: arguments, and what it reads first on its standard input."""
        return ["--credentials", STDIN], guests_line(self._guests)

    def _agent_access(self, name: str) -> tuple[list[str], bytes]:
        """How an agent proves who it is, and its walls: likewise."""
        return ["--walls", "--credential", STDIN], credential_line(self._guests.of(name))

    def _spawn(self, name: str, arguments: Sequence[str], secret: bytes, room: Path | None = None) -> None:
        """Start a process; one with a ``room`` gets nothing else of this machine than that."""
        before = [child for child in self._children if child.name == name]
        log = self._logs / (f"{name}.{len(before) + 1}.log" if before else f"{name}.log")
        for child in before:  # it has ended
            if child.process.stdin is not None:
                child.process.stdin.close()
        environment = room_environment(os.environ, room, Path.cwd()) if room else os.environ
        with log.open("wb") as output:
            process = subprocess.Popen(
                [sys.executable, "-m", "deploy.cli", *arguments],
                cwd=room,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE if room else output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=child_environment(environment),
            )
        self._rooms.keep_log(process, log)
        self._children.append(Child(name, process, log))
        if process.stdin is not None:
            with suppress(BrokenPipeError):  # it has ended already, and its log says why
                process.stdin.write(secret)
                process.stdin.flush()
        if name == Role.LEADER:
            self._wishes.listener(process.stdin)

    def wait_until_listening(self) -> None:
        """Until the simulator's port is open, or the simulator has ended."""
        place = parse_endpoint(self._endpoint)
        while self.sim.process.poll() is None and not place.somebody_listens():
            time.sleep(POLL_S)

    @property
    def sim(self) -> Child:
        """The simulator's process: the newest, if it was killed and started again."""
        return next(child for child in reversed(self._children) if child.name == "sim")

    def watch(self, link: Link, show: Show) -> Ended:
        """Show progress until the simulator ends, or until an agent fails before the first tick.

        Raises:
            Interrupted: a signal asked for the end; :meth:`order_stop` comes next.
        """
        started = False
        news: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        link.subscribe(Keys(self._run).progress, news.put)
        slowed = sorted((event for event in self._scenario.events if isinstance(event, Slow)), key=lambda e: e.at_s)
        shares = [(event.agent, event.share_percent / 100) for event in slowed]
        self._processes = Processes(self._process_of, self._start_agent, self._restart_sim, shares, self._relays)
        doer = Doer(link, self._run, self._processes.do)
        orders = link.publisher(Keys(self._run).order)
        self._mailbox = Mailbox(self._folder)
        while self.sim.process.poll() is None:
            for order in self._mailbox.take():
                orders.put(encode(order))
            while not news.empty():
                progress = decode(news.get(), Progress)
                started = started or progress.phase == "running"
                show(progress)
            failed = None if started or doer.was_asked else self._failed_agent()
            if failed is not None:
                time.sleep(2 * POLL_S)  # its log may still be on the way to the disk
                return Ended(
                    failed.process.returncode, f"{failed.name} ended before the first tick: {failed.last_words()}"
                )
            doer.do_for(POLL_S)
        status = self.sim.process.returncode
        return Ended(status, "" if status in (0, 1) else f"the simulator: {self.sim.last_words()}")

    def _process_of(self, name: str) -> subprocess.Popen[bytes] | None:
        """The newest process of an agent."""
        return next((child.process for child in reversed(self._children[1:]) if child.name == name), None)

    def _failed_agent(self) -> Child | None:
        return next((child for child in self._children[1:] if child.process.poll() not in (None, 0)), None)

    def order_stop(self, link: Link) -> None:
        """Tell the simulator to end the run and wait until it has written its folder."""
        order = link.publisher(Keys(self._run).order)
        deadline = time.monotonic() + STOP_S
        while self.sim.process.poll() is None and time.monotonic() < deadline:
            if order.matched():
                order.put(encode(Order("stop", 0)))
            time.sleep(2 * POLL_S)

    def end_all(self) -> None:
        """End every process that is left: politely, then for good."""
        if self._processes is not None:
            self._processes.end()
        for signal_number, patience_s in ((signal.SIGTERM, TERM_S), (signal.SIGKILL, TERM_S)):
            alive = [child for child in self._children if child.process.poll() is None]
            for child in alive:
                child.process.send_signal(signal_number)
                if signal_number == signal.SIGTERM:  # one that is stopped cannot obey before it goes on
                    child.process.send_signal(signal.SIGCONT)
            deadline = time.monotonic() + patience_s
            while any(child.process.poll() is None for child in alive) and time.monotonic() < deadline:
                time.sleep(POLL_S)
        for child in self._children:
            with suppress(ProcessLookupError, PermissionError):  # what a law has started goes with it
                os.killpg(child.process.pid, signal.SIGKILL)
            if child.process.stdin is not None:
                with suppress(BrokenPipeError):
                    child.process.stdin.close()
        self._rooms.clear()
        while self._relays:
            self._relays.popitem()[1].close()
        if self._mailbox is not None:
            self._mailbox.close()
            self._mailbox = None


def child_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """One thread per process: the matrices are small, and more threads only disturb each other."""
    return {**environment, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
