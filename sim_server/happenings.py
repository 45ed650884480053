"""A scenario's events and the operator's wishes, each at its tick: deeds done to processes, hands that fail, robots
that come. Every event is reported as ordered, and as seen to take effect.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from typing import Protocol

from sim_server.faults.event import Event, Lasting, Seen
from sim_server.faults.grasps import FailGrasp, GraspSlip
from sim_server.faults.message import MessageEvent
from sim_server.faults.physical import PhysicalEvent
from sim_server.faults.processes import ToProcess
from sim_server.faults.proofs import Proofs
from sim_server.faults.pushes import Push
from sim_server.grasping import Closing
from sim_server.lockstep import Ticker
from sim_server.newcomers import CannotCome
from sim_server.process_deeds import ProcessDeeds, Undone, undone
from sim_server.reception import Reception, Report
from sim_server.scenario_events import AnyEvent, Join, Whole, in_order
from sim_server.snapshot import Snapshot, SnapshotError
from sim_server.world_builder import NotBuilt
from wire.link import Publisher

LEAD_S = 2.5
"""Simulated time before a newcomer's tick at which its world is begun and its agent started."""


class Hands(Protocol):
    """What has become of the plant's hands since it was last looked at."""

    opened: list[str]
    grasped: list[Closing]

    def holds(self, arm: str) -> bool: ...


class News(Protocol):
    """What has been seen of events since it was last looked at."""

    news: list[Seen]


class Faults(News, Protocol):
    """The plant's faults: see :class:`sim_server.faults.damage.Damage`."""

    def begin(self, event: PhysicalEvent, tick: int, end: int | None) -> None: ...

    def finish(self) -> None: ...


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


class Plant(Protocol):
    """What the events need of the plant."""

    @property
    def hands(self) -> Hands: ...

    @property
    def disturbances(self) -> News: ...

    @property
    def damage(self) -> Faults: ...

    @property
    def names(self) -> list[str]: ...

    def push(self, event: Push) -> None: ...

    def loosen(self, arm: str, force_N: float) -> None: ...

    def slip(self, arm: str) -> None: ...


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
    ) -> None:
        self._newcomers, self._waits, self._ticks = newcomers, waits, ticks
        self._unforeseen: set[str] = set()
        """Robots that no scenario has."""
        self._late: list[tuple[float, Join]] = []
        """Real time: newcomers whose time has come, but who are not ready; with the wall time at which they are given
        up."""
        self._prepared: dict[str, int] = {}
        """Newcomers that are prepared for, each with the number of its deed, or 0."""
        self._due = in_order(events, period_ms)
        self.proofs = Proofs(event for _, event in self._due)
        self._reception, self._clock, self._plant = reception, clock, plant
        self._report = report
        self._deeds = ProcessDeeds(
            reception, clock, publisher, report, start_s=start_s, waits=waits, proofs=self.proofs
        )
        self._period_ms, self._start_s = period_ms, start_s
        self._slips: list[tuple[int, str]] = []
        self._letting_go: list[GraspSlip] = []
        """Hands that were made to let go, and whose end has not been seen."""

    def before(self, tick: int) -> None:
        """Do what is due before this tick. Raises :class:`Undone`, and :class:`sim_server.lockstep.Stopped`."""
        hands = self._plant.hands
        self._clock.edge.settle(tick)
        self._tell_news()
        while hands.opened:
            self._report("hand_opened", agent=hands.opened.pop(0))
        while hands.grasped:
            closed = hands.grasped.pop(0)
            self._report("grasped", agent=closed.arm, closed_at_tick=closed.tick, force_max_N=closed.force_max_N)
        self._deeds.look()
        self._take_orders(tick)
        self._prepare(tick)
        self._newcomers.advance()
        while self._slips and self._slips[0][0] <= tick:
            _, arm = self._slips.pop(0)
            if hands.holds(arm):
                self._plant.slip(arm)
                self._report("seen", event="fail_grasp", agent=arm, effect="the hand has slipped off")
        self._look_at_hands()
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
            return
        self._report("ordered", event=event.kind, **_target(event))
        if isinstance(event, Push):
            self._check_is_there(event)
            self._plant.push(event)
        elif isinstance(event, MessageEvent):
            self._clock.edge.begin(event, self._end_tick(event))
        elif isinstance(event, PhysicalEvent):
            self._check_is_there(event)
            self._plant.damage.begin(event, tick, self._end_tick(event))
        elif isinstance(event, FailGrasp):
            self._check_holds(event)
            self._plant.loosen(event.arm, event.force_N)
            self._slips = sorted([*self._slips, (tick + round(event.for_s * 1000 / self._period_ms), event.arm)])
            self._see(Seen(event, "the hand holds badly"))
        elif isinstance(event, GraspSlip):
            self._check_holds(event)
            self._plant.slip(event.arm)
            self._letting_go.append(event)

    def _check_is_there(self, event: Push | Lasting) -> None:
        if event.arm is not None and event.arm not in self._plant.names:
            raise undone(event, "its robot is not there")

    def _check_holds(self, event: FailGrasp | GraspSlip) -> None:
        if not self._plant.hands.holds(event.arm):
            raise undone(event, "its hand holds nothing")

    def _end_tick(self, event: Lasting) -> int | None:
        """The tick from which on it is over."""
        return None if event.for_s is None else round((event.at_s + event.for_s) * 1000 / self._period_ms)

    def _look_at_hands(self) -> None:
        """Report those that were made to let go and have."""
        for event in [each for each in self._letting_go if not self._plant.hands.holds(each.arm)]:
            self._letting_go.remove(event)
            self._see(Seen(event, "the hand holds nothing"))

    def _tell_news(self) -> None:
        for news in (self._plant.disturbances.news, self._plant.damage.news, self._clock.edge.news):
            while news:
                self._see(news.pop(0))

    def _see(self, seen: Seen) -> None:
        if seen.proves:
            self.proofs.see(seen.event)
        self._report("seen", event=seen.event.kind, **_target(seen.event), effect=seen.effect)

    def finish(self) -> None:
        """The run has come to its end: tell what is to be told of what went on until then. Raises :class:`Undone`."""
        self._deeds.look()
        self._look_at_hands()
        self._clock.edge.finish()
        self._plant.damage.finish()
        self._tell_news()

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
        hands that will slip off, and the deeds."""
        wanted = [(tick, event) for tick, event in self._due if isinstance(event, Join) and self._is_unforeseen(event)]
        return {
            "due": len(self._due) - len(wanted),
            "wanted": [[tick, event.arm, event.strut] for tick, event in wanted],
            "late": [[event.arm, event.strut, self._is_unforeseen(event)] for _, event in self._late],
            "orders": list(self._clock.wanted),
            "slips": [list(slip) for slip in self._slips],
            "letting_go": [[event.at_s, event.arm] for event in self._letting_go],
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
        self._slips = [(int(tick), str(arm)) for tick, arm in saved["slips"]]
        self._letting_go = [
            GraspSlip(kind="grasp_slip", at_s=float(at_s), arm=str(arm)) for at_s, arm in saved["letting_go"]
        ]
        self._deeds.restore(saved["deeds"])
        self.proofs.restore(saved["proofs"])

    def _is_unforeseen(self, event: Join) -> bool:
        return event.arm in self._unforeseen


def _target(event: Event) -> dict[str, str]:
    """Whom an event is on, for the events' file."""
    if isinstance(event, Push) and event.arm is None:
        return {"point": event.point or "centre_of_mass"}
    whom = {"agent": str(arm)} if (arm := getattr(event, "arm", None)) else {"point": "load"}
    return whom | {"direction": event.direction} if isinstance(event, MessageEvent) else whom
