"""A scenario's events and the operator's wishes, each at its tick: deeds done to processes, hands that fail, robots
that come. Every event is reported as ordered, and as seen to take effect.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from typing import Protocol

from sim_server.faults.onset import Onset, Plant
from sim_server.faults.processes import SimKill, ToProcess
from sim_server.faults.proofs import Proofs
from sim_server.lockstep import Ticker
from sim_server.newcomers import CannotCome
from sim_server.process_deeds import SIM, ProcessDeeds, Undone, undone
from sim_server.reception import Reception, Report
from sim_server.scenario_events import AnyEvent, Join, Whole, in_order
from sim_server.snapshot import Snapshot, SnapshotError
from sim_server.world_builder import NotBuilt
from wire.link import Publisher

LEAD_S = 2.5
"""Simulated time before a newcomer's tick at which its world is begun and its agent started."""


class Arrivals(Protocol):
    """Who comes: see :class:`sim_server.newcomers.Newcomers`."""

    def advance(self) -> None: ...

    def check(self, strut: int, promised: Collection[int]) -> None: ...

    def know(self, arm: str) -> None: ...

    def next_name(self) -> str: ...

    def prepare(self, arm: str, strut: int) -> None: ...

    def is_ready(self, arm: str) -> bool: ...

    def arrive(self, arm: str) -> float: ...

    def cancel(self, arm: str, why: str) -> None: ...


class Happenings:
    """The events of one run.

    Args:
        events: of the scenario.
        period_ms: of a tick.
        publisher: to the launcher.
        start_s: wall time that a started agent has to be in.
        newcomers: those who come.
        waits: whether the clock stands until a newcomer is there (lock-step), or it comes when it is ready.
        ticks: of the whole run.
        save: waits until the last checkpoint is on the disk.
    """

    def __init__(
        self,
        events: Sequence[AnyEvent],
        reception: Reception,
        clock: Ticker,
        plant: Plant,
        publisher: Publisher,
        report: Report,
        *,
        period_ms: int,
        start_s: float,
        newcomers: Arrivals,
        waits: bool,
        ticks: int,
        save: Callable[[], None] = lambda: None,
    ) -> None:
        self._save = save
        self._newcomers, self._waits, self._ticks = newcomers, waits, ticks
        self._unforeseen: set[str] = set()
        """Robots that no scenario has."""
        self._late: list[tuple[float, Join]] = []
        """Real time: newcomers whose time has come, but who are not ready; with the wall time at which they are given
        up."""
        self._prepared: dict[str, int] = {}
        """Newcomers that are prepared for, each with the number of its deed, or 0."""
        self._all = in_order(events, period_ms)
        self._due = list(self._all)
        self.proofs = Proofs(event for _, event in self._all)
        self._onset = Onset(clock, plant, report, period_ms=period_ms, proofs=self.proofs)
        self._reception, self._clock, self._report = reception, clock, report
        self._deeds = ProcessDeeds(
            reception, clock, publisher, report, start_s=start_s, waits=waits, proofs=self.proofs
        )
        self._period_ms, self._start_s = period_ms, start_s

    def before(self, tick: int) -> None:
        """Do what is due before this tick. Raises :class:`Undone`, and :class:`sim_server.lockstep.Stopped`."""
        self._onset.look(tick)
        self._deeds.look()
        self._take_orders(tick)
        self._prepare(tick)
        self._newcomers.advance()
        self._onset.slip(tick)
        self._let_late_ones_come()
        while self._due and self._due[0][0] <= tick:
            _, event = self._due.pop(0)
            if not isinstance(event, Join):
                self._do(tick, event)
            elif self._is_ready(event):
                self._let_come(event)
            else:
                self._late.append((time.monotonic() + self._start_s, event))

    def _do(self, tick: int, event: Whole) -> None:
        """Do what is due now. Raises :class:`Undone`."""
        self.proofs.order(event)
        if isinstance(event, ToProcess):
            self._deeds.do(event)
        elif isinstance(event, SimKill):
            self._save()  # so that it is certain from where the next one goes on
            self._deeds.die(event)
        elif not isinstance(event, Join):
            self._onset.begin(tick, event)

    def survive(self, deaths: int, tick: int) -> None:
        """The simulator has been killed by so many events, and has gone on from this tick: they do not happen again."""
        kills = [event for _, event in self._all if isinstance(event, SimKill)][:deaths]
        self._due = [(due, event) for due, event in self._due if event not in kills]
        for event in kills:
            self.proofs.order(event)
            self.proofs.see(event)
        if kills:
            effect = f"another simulator goes on from tick {tick}"
            self._report("seen", event=kills[-1].kind, agent=SIM, effect=effect)

    def finish(self) -> None:
        """The run has come to its end: tell what is to be told of what went on until then. Raises :class:`Undone`."""
        self._deeds.look()
        self._onset.finish()

    def _take_orders(self, tick: int) -> None:
        """Robots that the operator wants and nobody foresaw."""
        while self._clock.wanted:
            strut = self._clock.wanted.pop(0)
            due = tick + self._lead_ticks
            try:
                if due >= self._ticks:
                    raise CannotCome(f"the run ends before a robot could come, {LEAD_S:g} s after it is wanted")
                self._newcomers.check(strut - 1, [event.strut - 1 for event in self._to_come()])
            except CannotCome as error:
                self._report("refused_order", event="join", strut=strut, text=str(error))
                continue
            arm = self._newcomers.next_name()
            event = self._want(due, arm, strut)
            self._report("wanted", event="join", agent=arm, strut=strut, at_s=event.at_s)

    def _want(self, due: int, arm: str, strut: int) -> Join:
        event = Join(at_s=due * self._period_ms / 1000, kind="join", arm=arm, strut=strut)
        self._unforeseen.add(arm)
        self._newcomers.know(arm)
        self._due = sorted([*self._due, (due, event)], key=lambda each: each[0])
        return event

    @property
    def _lead_ticks(self) -> int:
        return round(LEAD_S * 1000 / self._period_ms)

    def _prepare(self, tick: int) -> None:
        """Build the worlds and start the agents of those who come soon; nobody waits for that."""
        for due, event in self._due:
            if due > tick + self._lead_ticks:
                return
            if isinstance(event, Join) and event.arm not in self._prepared:
                self._newcomers.prepare(event.arm, event.strut - 1)
                self._prepared[event.arm] = self._deeds.order(event.arm, "start") if self._deeds.somebody_listens else 0

    def _to_come(self) -> list[Join]:
        """All robots that are still to come, foreseen or not."""
        return [event for _, event in [*self._due, *self._late] if isinstance(event, Join)]

    def _is_ready(self, event: Join) -> bool:
        """Whether nobody has to wait for this newcomer; in lock-step everybody waits."""
        number = self._prepared[event.arm]
        return self._waits or (self._newcomers.is_ready(event.arm) and (not number or number in self._clock.done))

    def _let_late_ones_come(self) -> None:
        for late in list(self._late):
            until_s, event = late
            if self._is_ready(event):
                self._late.remove(late)
                self._let_come(event)
            elif time.monotonic() > until_s:
                self._late.remove(late)
                self._give_up(event, f"it was not ready {self._start_s:g} s after its time")

    def _let_come(self, event: Join) -> None:
        """The robot is there from now on. Raises :class:`Undone`."""
        self.proofs.order(event)
        self._report("ordered", event=event.kind, agent=event.arm, strut=event.strut)
        try:
            self._await_its_process(event)
            pause_s = self._newcomers.arrive(event.arm)
        except (CannotCome, NotBuilt) as error:
            self._give_up(event, str(error))
            return
        agent = self._reception.agents[event.arm]
        if self._waits and event.arm not in self._unforeseen:  # what nobody foresaw does not hold the others up
            self._deeds.wait(lambda: agent.is_in and agent.alive, event, "it has not joined", self._start_s)
        effect = f"it stands outside, by strut {event.strut}"
        self.proofs.see(event)
        self._report("seen", event=event.kind, agent=event.arm, effect=effect, pause_ms=1e3 * pause_s)

    def _give_up(self, event: Join, why: str) -> None:
        """It does not come: a run that did not foresee it goes on. Raises :class:`Undone` if the scenario wants it."""
        self._newcomers.cancel(event.arm, why)
        if event.arm not in self._unforeseen:
            raise undone(event, why)
        self._report("refused_order", event=event.kind, agent=event.arm, strut=event.strut, text=why)

    def _await_its_process(self, event: Join) -> None:
        """Raises :class:`CannotCome` if the launcher could not start it, or does not say."""
        number = self._prepared[event.arm]
        if not number:
            return
        try:
            self._deeds.wait(
                lambda: number in self._clock.done, event, "the launcher has not reported it", self._start_s
            )
        except Undone:
            raise CannotCome(f"the launcher has not reported its start within {self._start_s:g} s") from None
        if self._clock.done[number]:
            raise CannotCome(self._clock.done[number])

    def state(self) -> Snapshot:
        """How many of the scenario's events are still to come, the robots that somebody wants, those that are late, the
        faults, and the deeds."""
        wanted = [(tick, event) for tick, event in self._due if isinstance(event, Join) and self._is_unforeseen(event)]
        return {
            "due": len(self._due) - len(wanted),
            "wanted": [[tick, event.arm, event.strut] for tick, event in wanted],
            "late": [[event.arm, event.strut, self._is_unforeseen(event)] for _, event in self._late],
            "orders": list(self._clock.wanted),
            "onset": self._onset.state(),
            "deeds": self._deeds.state(),
            "proofs": self.proofs.state(),
        }

    def restore(self, saved: Snapshot) -> None:
        """Only what was still to come will happen."""
        due = int(saved["due"])
        if not 0 <= due <= len(self._due):
            raise SnapshotError(f"events: got {due} to come, expected at most {len(self._due)}")
        self._due = self._due[len(self._due) - due :]
        for tick, arm, strut in saved["wanted"]:
            self._want(int(tick), str(arm), int(strut))
        for arm, strut, unforeseen in saved["late"]:
            event = self._want(0, str(arm), int(strut))  # at once
            if not unforeseen:
                self._unforeseen.discard(event.arm)
        self._clock.wanted[:] = map(int, saved["orders"])
        self._onset.restore(saved["onset"])
        self._deeds.restore(saved["deeds"])
        self.proofs.restore(saved["proofs"])

    def _is_unforeseen(self, event: Join) -> bool:
        return event.arm in self._unforeseen
