"""The real-time clock: physics follows the wall clock, nobody is waited for, and an arm obeys its latest command.

Tick k begins at the start plus k periods: its states go out, answers are taken in until just before tick k + 1, the
physics steps. Who has sent nothing new by then has missed the tick, and the driver holds its last command; after
``missed_ticks_until_lost`` in a row the arm is lost. A late answer still counts as the latest.

A server that is late hurries, but by no more than ``MOST_BEHIND`` ticks, each with half a period for the answers. What
is beyond that it never makes up for: simulated time is slower than the wall clock then, and the run says so.
"""

from __future__ import annotations

import queue
import time
from typing import Protocol

from sim_server.faults.edge import Edge
from sim_server.lockstep import Ticker
from sim_server.plant import Plant
from sim_server.reception import LEADER, Agent, Arrived, Reception, Report
from wire.lifecycle import Phase
from wire.messages import Command, LeaderForce

MOST_BEHIND = 3
"""Ticks that the server may be late and still make up for: the longest burst that agents and plant have to stand."""
FIRST_ANSWER_NS = 1_000_000_000
"""Simulated time that an agent has for its first answer before ticks count as missed: what a law needs when it runs for
the first time has to be fetched into memory, which can take longer than 20 ticks; nobody relies on it yet."""
SPIN_NS = 60_000
"""End of a sleep that is spent looking at the clock, since the kernel wakes a sleeper up to 50 us late."""
TELL_EVERY_NS = 1_000_000_000
"""Simulated time between two events that say that the run slows down; the total is in the metrics."""


class WallTime(Protocol):
    """Time as the clock sees it; tests have their own."""

    def now_ns(self) -> int: ...

    def sleep_until(self, time_ns: int) -> None: ...

    def next_of(self, inbox: queue.SimpleQueue[Arrived], until_ns: int) -> Arrived | None:
        """What arrives next, or None if nothing does until then."""
        ...


class MachineTime:
    """The machine's own clock, which nobody sets."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until(self, time_ns: int) -> None:
        while (left := time_ns - time.monotonic_ns()) > SPIN_NS:
            time.sleep(1e-9 * (left - SPIN_NS))
        while time.monotonic_ns() < time_ns:
            pass

    def next_of(self, inbox: queue.SimpleQueue[Arrived], until_ns: int) -> Arrived | None:
        try:
            return inbox.get(timeout=max(0.0, 1e-9 * (until_ns - time.monotonic_ns())))
        except queue.Empty:
            return None


class RealTime(Ticker):
    """Waits for nobody: see the module.

    Args:
        wall: where time comes from.
    """

    def __init__(
        self,
        reception: Reception,
        plant: Plant,
        *,
        period_ns: int,
        leader_every: int,
        report: Report,
        wall: WallTime | None = None,
        edge: Edge | None = None,
    ) -> None:
        super().__init__(reception, plant, period_ns=period_ns, leader_every=leader_every, report=report, edge=edge)
        self._wall = wall or MachineTime()
        self._due_ns: int | None = None
        """When the present tick was to begin; None before the first."""
        self._gathered_ns = 0
        self._closing_ns = 0
        """What physics and record of a tick have taken lately: answers are due so long before the next tick."""
        self._told_ns: int | None = None

    def tick(self, tick: int) -> None:
        """Wait for this tick's time, then one tick up to, and without, the plant's step. Raises :class:`Stopped`."""
        self._begin(tick)
        super().tick(tick)

    def _begin(self, tick: int) -> None:
        now = self._wall.now_ns()
        if self._due_ns is None:
            self._due_ns = now
        else:
            took = min(now - self._gathered_ns, self._period_ns // 2)  # the agents keep their half
            self._closing_ns += (took - self._closing_ns) // (2 if took > self._closing_ns else 16)
            self._due_ns += self._period_ns
            self._wall.sleep_until(self._due_ns)
        late = max(0, self._wall.now_ns() - self._due_ns)
        self.punctuality.note_late(late)
        if late > MOST_BEHIND * self._period_ns:
            self._slow_down(tick, late)

    def _slow_down(self, tick: int, late_ns: int) -> None:
        """Give up what is behind: this tick begins now, and those after it a period apart from here."""
        assert self._due_ns is not None
        self._due_ns += late_ns
        self.punctuality.slowed_ns += late_ns
        time_ns = tick * self._period_ns
        if self._told_ns is None or time_ns - self._told_ns >= TELL_EVERY_NS:
            self._told_ns = time_ns
            self._report("slowed", late_ms=round(1e-6 * late_ns, 3), slowed_s=1e-9 * self.punctuality.slowed_ns)

    def _accept(self, agent: Agent, message: Command | LeaderForce) -> None:
        agent.link.answer_latest(message)

    def _gather(self, tick: int) -> None:
        """Take in what arrives until the answers are due, or all have answered."""
        assert self._due_ns is not None
        inbox, agents = self._reception.inbox, self._reception.agents
        self._waiting.clear()  # that is lock-step's
        least_ns = self._wall.now_ns() + self._period_ns // 2  # a server that hurries gives them time all the same
        due_ns = max(self._due_ns + self._period_ns - self._closing_ns, least_ns)
        while self._somebody_may_answer(tick):
            arrived = self._wall.next_of(inbox, due_ns)
            if arrived is None:
                break
            self.take(arrived)
        while not inbox.empty():
            self.take(inbox.get())
        for name, agent in agents.items():
            if agent.link.open_tick is not None and self._is_over(name, tick):
                self._miss(name, agent)
            if agent.link.phase is Phase.TICKING and agent.link.answered_tick is not None:
                self.punctuality.note_age(name, tick - agent.link.answered_tick)
        self._gathered_ns = self._wall.now_ns()

    def _somebody_may_answer(self, tick: int) -> bool:
        """Whether an answer to the newest state is still to come: an earlier one, though it counts, is not enough, or
        an arm that was late once would stay a tick behind for ever. The leader has until its next view."""
        return any(
            agent.link.phase is Phase.TICKING
            and agent.link.answered_tick != agent.link.last_tick
            and self._is_over(name, tick)
            for name, agent in self._reception.agents.items()
        )

    def _is_over(self, name: str, tick: int) -> bool:
        """Whether this agent gets its next state in the next tick."""
        return name != LEADER or (tick + 1) % self._leader_every == 0

    def _miss(self, name: str, agent: Agent) -> None:
        """Misses are counted and not told one by one: here they are no accident."""
        if agent.link.answered_tick is None and agent.link.excused * agent.terms.period_ns < FIRST_ANSWER_NS:
            agent.link.excuse()
        elif agent.link.miss():
            self._lose(name, f"{agent.link.missed_in_row} ticks without an answer")
        elif 2 * agent.link.missed_in_row == agent.link.invitation.lost_after:
            self._report("missed", agent=name, in_row=agent.link.missed_in_row)
