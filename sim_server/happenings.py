"""A scenario's events, each at its tick: ordered, done, and the clock waits until the deed is seen.

Processes are the launcher's: the simulator asks it on ``truth/deeds`` and hears back on ``operator/order``. What
counts is seen here, though: a killed agent's sign of life is gone, a started one has greeted and is matched.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from sim_server.errors import SimError
from sim_server.lockstep import Ticker
from sim_server.reception import Reception, Report
from sim_server.scenario_events import FailGrasp, ProcessEvent, in_order
from sim_server.snapshot import Snapshot, SnapshotError
from wire.codec import encode
from wire.lifecycle import Phase
from wire.link import Publisher
from wire.messages import Deed

DEED_S = 20.0
"""Wall time that a deed may take until it is seen; a start has the scenario's start timeout."""
NOBODY_S = 3.0
"""Wall time in which the launcher must be listening: it is there before the first tick."""


class Undone(SimError):
    """A deed that the scenario wants was not done, so what comes after would not be the scenario's run."""

    exit_status = 3


class Hands(Protocol):
    """What the events need of the plant."""

    opened: list[str]
    """Arms whose hands have opened since this was last looked at."""

    def loosen(self, arm: str, force_N: float) -> None: ...

    def slip(self, arm: str) -> None: ...


class Happenings:
    """The events of one run.

    Args:
        events: of the scenario.
        period_ms: of a tick.
        publisher: to the launcher.
        start_s: wall time that a started agent has to be in.
    """

    def __init__(
        self,
        events: Sequence[ProcessEvent | FailGrasp],
        reception: Reception,
        clock: Ticker,
        hands: Hands,
        publisher: Publisher,
        report: Report,
        *,
        period_ms: int,
        start_s: float,
    ) -> None:
        self._due = in_order(events, period_ms)
        self._reception, self._clock, self._hands = reception, clock, hands
        self._publisher, self._report = publisher, report
        self._period_ms, self._start_s = period_ms, start_s
        self._slips: list[tuple[int, str]] = []
        self._number = 0

    def before(self, tick: int) -> None:
        """Do what is due before this tick. Raises :class:`Undone`, and :class:`sim_server.lockstep.Stopped`."""
        while self._hands.opened:
            self._report("hand_opened", agent=self._hands.opened.pop(0))
        while self._slips and self._slips[0][0] <= tick:
            _, arm = self._slips.pop(0)
            self._hands.slip(arm)
            self._report("seen", event="fail_grasp", agent=arm, effect="the hand has slipped off")
        while self._due and self._due[0][0] <= tick:
            _, event = self._due.pop(0)
            if isinstance(event, FailGrasp):
                self._report("ordered", event=event.kind, agent=event.arm)
                self._hands.loosen(event.arm, event.force_N)
                self._slips = sorted([*self._slips, (tick + round(event.for_s * 1000 / self._period_ms), event.arm)])
                self._report("seen", event=event.kind, agent=event.arm, effect="the hand holds badly")
            else:
                self._report("ordered", event=event.kind, agent=event.agent)
                self._report("seen", event=event.kind, agent=event.agent, effect=self._do(event))

    def state(self) -> Snapshot:
        """How many events are still to come, the hands that will slip off, and the number of the last deed."""
        return {"due": len(self._due), "slips": [list(slip) for slip in self._slips], "number": self._number}

    def restore(self, saved: Snapshot) -> None:
        """Only what was still to come will happen."""
        due = int(saved["due"])
        if not 0 <= due <= len(self._due):
            raise SnapshotError(f"events: got {due} to come, expected at most {len(self._due)}")
        self._due = self._due[len(self._due) - due :]
        self._slips = [(int(tick), str(arm)) for tick, arm in saved["slips"]]
        self._number = int(saved["number"])

    def _do(self, event: ProcessEvent) -> str:
        """Have it done; what was seen of it."""
        agent, name = self._reception.agents[event.agent], event.agent
        if event.kind in ("kill", "start"):
            self._clock.thaw(name)
        seconds = self._start_s if event.kind == "start" else DEED_S
        self._ask(event, seconds)
        if event.kind == "kill":
            self._wait(lambda: not agent.alive, event, "its sign of life is still there", seconds)
            return "its sign of life is gone"
        if event.kind == "leave":
            self._wait(lambda: agent.link.phase is Phase.LEFT, event, f"it is still {agent.link.phase}", seconds)
            self._wait(lambda: not agent.alive, event, "its sign of life is still there", seconds)
            return "it said goodbye"
        if event.kind == "start":
            self._wait(lambda: agent.is_in and agent.alive, event, "it has not joined", seconds)
            return f"it has joined with lease {agent.link.lease}"
        if event.kind == "stop":
            self._clock.freeze(name)
            return "the kernel has stopped it"
        self._clock.thaw(name)
        if agent.link.phase is Phase.LOST:
            return "it runs again, but was lost meanwhile: its lease is worth nothing"
        return "it runs again"

    def _ask(self, event: ProcessEvent, seconds: float) -> None:
        self._wait(
            self._publisher.matched,
            event,
            "nobody is there to do it. Processes are the launcher's: use `palanquin run`, or agents started by hand "
            "without such events",
            NOBODY_S,
        )
        number = self._number = self._number + 1
        self._publisher.put(encode(Deed(number, event.kind, event.agent)))
        done = self._clock.done
        self._wait(lambda: number in done, event, "the launcher has not reported it", seconds)
        if done[number]:
            raise Undone(_sentence(event, done[number]))

    def _wait(self, seen: Callable[[], bool], event: ProcessEvent, else_: str, seconds: float) -> None:
        """Take in what comes until the deed is seen."""
        deadline = time.monotonic() + seconds
        while not seen():
            if time.monotonic() > deadline:
                raise Undone(_sentence(event, f"{else_} (waited {seconds:g} s)"))
            try:
                self._clock.take(self._reception.inbox.get(timeout=0.005))
            except queue.Empty:
                self._clock.admit()


def _sentence(event: ProcessEvent, problem: str) -> str:
    return f"event {event.kind!r} of {event.agent} at {event.at_s:g} s was not done: {problem}"
