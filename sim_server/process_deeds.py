"""What a scenario does to processes: asked of the launcher, whose they are, and the clock stands until it is seen.

The simulator asks on ``truth/deeds`` and hears back on ``operator/order``. What counts is seen here, though: a killed
agent's sign of life is gone, a started one has greeted and is matched. To leave in order takes an agent simulated time:
the clock stands until it has said that it is leaving, and goes on; that it has gone is seen later.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from dataclasses import dataclass

from sim_server.errors import SimError
from sim_server.faults.event import Event
from sim_server.faults.processes import AnyVerb, ProcessEvent, SimKill, ToProcess
from sim_server.faults.proofs import Proofs, describe
from sim_server.lockstep import Ticker
from sim_server.reception import Agent, Reception, Report
from sim_server.snapshot import Snapshot
from wire.codec import encode
from wire.lifecycle import Phase
from wire.link import Publisher
from wire.messages import Deed

DEED_S = 20.0
"""Wall time that a deed may take until it is seen; a start has the scenario's start timeout."""
NOBODY_S = 3.0
"""Wall time in which the launcher must be listening: it is there before the first tick."""

SIM = "sim"
"""The simulator, among those to whom something is done."""


class Undone(SimError):
    """A deed that the scenario wants was not done, so what comes after would not be the scenario's run."""

    exit_status = 3


@dataclass(slots=True)
class Going:
    """An agent that was told to leave and has not gone yet."""

    event: ToProcess
    lease: int
    """Of the instance that was told; 0 if that was in a simulator before this one."""


class ProcessDeeds:
    """The deeds of one run.

    Args:
        publisher: to the launcher.
        start_s: wall time that a started agent has to be in.
        waits: whether the clock stands until the sign of life of an agent that has left is gone (lock-step).
        proofs: where it is noted what has been seen.
    """

    def __init__(
        self,
        reception: Reception,
        clock: Ticker,
        publisher: Publisher,
        report: Report,
        *,
        start_s: float,
        waits: bool,
        proofs: Proofs,
    ) -> None:
        self._reception, self._clock, self._publisher, self._report = reception, clock, publisher, report
        self._start_s, self._waits, self._proofs = start_s, waits, proofs
        self._number = 0
        self._going: list[Going] = []

    @property
    def somebody_listens(self) -> bool:
        """Whether the launcher is there."""
        return self._publisher.matched()

    def order(self, agent: str, verb: AnyVerb) -> int:
        """Ask the launcher for a deed; its number."""
        self._number += 1
        self._publisher.put(encode(Deed(self._number, verb, agent)))
        return self._number

    def do(self, event: ToProcess) -> None:
        """Have it done, and report it as soon as it is seen. Raises :class:`Undone`."""
        self._report("ordered", event=event.kind, agent=event.agent)
        if event.kind == "leave":
            self._send_away(event)
        else:
            self._seen(event, self._do(event))

    def die(self, event: SimKill) -> None:
        """Ask for the death of this very process, and wait for it. Raises :class:`Undone`: it has not come."""
        self._report("ordered", event=event.kind, agent=SIM)
        self._wait_for_somebody(event)
        number, done = self.order(SIM, "kill"), self._clock.done
        self.wait(lambda: number in done, event, "this process is still there", DEED_S)
        raise undone(event, done[number] or "the launcher says so, but this process is still there")

    def look(self) -> None:
        """Report those who were told to leave and have gone since. Raises :class:`Undone` if one only says so."""
        for going in list(self._going):
            agent = self._reception.agents[going.event.agent]
            gone = self._how_it_went(going, agent)
            if not gone or (agent.link.phase is Phase.LEFT and agent.alive and not self._waits):
                continue
            if agent.link.phase is Phase.LEFT:
                self._wait_until_dead(agent, going.event, DEED_S)
            self._going.remove(going)
            self._seen(going.event, gone, proves=agent.link.phase is Phase.LEFT)

    @staticmethod
    def _how_it_went(going: Going, agent: Agent) -> str:
        """In words; none while it is still going."""
        if agent.link.phase is Phase.LEFT:
            return "it said goodbye"
        if agent.link.phase is Phase.LOST or going.lease not in (0, agent.link.lease):
            return "it was lost before it had gone"
        return ""

    def _seen(self, event: ToProcess, effect: str, *, proves: bool = True) -> None:
        if proves:
            self._proofs.see(event)
        self._report("seen", event=event.kind, agent=event.agent, effect=effect)

    def _send_away(self, event: ToProcess) -> None:
        agent = self._reception.agents[event.agent]
        link = agent.link
        self.wait(lambda: agent.alive or not agent.is_in, event, "it has shown no sign of life", DEED_S)
        self._ask(event, DEED_S)
        self.wait(
            lambda: link.leaving or link.phase in (Phase.LEFT, Phase.LOST),
            event,
            "it has neither said that it is leaving nor goodbye",
            DEED_S,
        )
        self._going.append(Going(event, link.lease))
        self.look()

    def _do(self, event: ToProcess) -> str:
        """Have it done; what was seen of it."""
        agent, name = self._reception.agents[event.agent], event.agent
        if event.kind in ("kill", "start"):
            self._clock.thaw(name)
        seconds = self._start_s if event.kind in ("start", "reconnect") else DEED_S
        self._ask(event, seconds)
        if event.kind in ("kill", "disconnect"):
            self._wait_until_dead(agent, event, seconds)
            return "its sign of life is gone"
        if event.kind in ("start", "reconnect"):
            if agent.is_gone:
                raise undone(event, "its robot has been taken away")
            self.wait(lambda: agent.is_in and agent.alive, event, "it has not joined", seconds)
            return f"it has joined with lease {agent.link.lease}"
        if event.kind == "stop":
            self._clock.freeze(name)
            return "the kernel has stopped it"
        if event.kind == "hang":  # nobody tells the clock: to find out is its own affair
            self.wait(lambda: agent.alive, event, "its sign of life is gone", seconds)
            return "the kernel has stopped its control loop, and its sign of life is there"
        if event.kind == "slow":
            return "the kernel has stopped it and let it go on, again and again"
        self._clock.thaw(name)
        if agent.link.phase is Phase.LOST:
            return "it runs again, but was lost meanwhile: its lease is worth nothing"
        return "it runs again"

    def _wait_until_dead(self, agent: Agent, event: ToProcess, seconds: float) -> None:
        self.wait(lambda: not agent.alive, event, "its sign of life is still there", seconds)

    def _wait_for_somebody(self, event: Event) -> None:
        self.wait(
            self._publisher.matched,
            event,
            "nobody is there to do it. Processes are the launcher's: use `palanquin run`, or agents started by hand "
            "without such events",
            NOBODY_S,
        )

    def _ask(self, event: ToProcess, seconds: float) -> None:
        self._wait_for_somebody(event)
        number = self.order(event.agent, event.kind)
        done = self._clock.done
        self.wait(lambda: number in done, event, "the launcher has not reported it", seconds)
        if done[number]:
            raise undone(event, done[number])

    def wait(self, seen: Callable[[], bool], event: Event, else_: str, seconds: float) -> None:
        """Take in what comes until something is seen. Raises :class:`Undone`, with ``else_``, if it is not in time."""
        deadline = time.monotonic() + seconds
        while not seen():
            if time.monotonic() > deadline:
                raise undone(event, f"{else_} (waited {seconds:g} s)")
            try:
                self._clock.take(self._reception.inbox.get(timeout=0.005))
            except queue.Empty:
                self._clock.admit()

    def state(self) -> Snapshot:
        """The number of the last deed, and who was told to leave, when."""
        return {"number": self._number, "going": [[going.event.agent, going.event.at_s] for going in self._going]}

    def restore(self, saved: Snapshot) -> None:
        """Go on from there."""
        self._number = int(saved["number"])
        self._going = [
            Going(ProcessEvent(at_s=float(at_s), kind="leave", agent=str(agent)), 0) for agent, at_s in saved["going"]
        ]


def undone(event: Event, problem: str) -> Undone:
    """The error for an event that was not done."""
    return Undone(f"{describe(event)} was not done: {problem}")
