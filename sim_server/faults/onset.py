"""Faults begin at their ticks, each where it acts, and what is seen of them is reported, and noted as their proof."""

from __future__ import annotations

from typing import Protocol

from sim_server.faults.event import Event, Lasting, Seen
from sim_server.faults.grasps import FailGrasp, GraspSlip
from sim_server.faults.message import MessageEvent
from sim_server.faults.physical import PhysicalEvent
from sim_server.faults.proofs import Proofs
from sim_server.faults.pushes import Push
from sim_server.grasping import Closing
from sim_server.lockstep import Ticker
from sim_server.process_deeds import undone
from sim_server.reception import Report
from sim_server.snapshot import Snapshot

Begun = FailGrasp | GraspSlip | Push | MessageEvent | PhysicalEvent
"""All faults but those of processes."""


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


class Onset:
    """The faults of one run that act at its edge or in its plant.

    Args:
        clock: with the edge.
        period_ms: of a tick.
        proofs: where it is noted what has been seen.
    """

    def __init__(self, clock: Ticker, plant: Plant, report: Report, *, period_ms: int, proofs: Proofs) -> None:
        self._clock, self._plant, self._report = clock, plant, report
        self._period_ms, self._proofs = period_ms, proofs
        self._slips: list[tuple[int, str]] = []
        """Hands that hold badly, with the tick at which they slip off."""
        self._letting_go: list[GraspSlip] = []
        """Hands that were made to let go, and whose end has not been seen."""

    def look(self, tick: int) -> None:
        """Before a tick: report what has been seen since the last."""
        hands = self._plant.hands
        self._clock.edge.settle(tick)
        self._tell_news()
        while hands.opened:
            self._report("hand_opened", agent=hands.opened.pop(0))
        while hands.grasped:
            closed = hands.grasped.pop(0)
            self._report("grasped", agent=closed.arm, closed_at_tick=closed.tick, force_max_N=closed.force_max_N)

    def slip(self, tick: int) -> None:
        """Hands that hold badly slip off when their time has come, and those that were made to let go have."""
        hands = self._plant.hands
        while self._slips and self._slips[0][0] <= tick:
            _, arm = self._slips.pop(0)
            if hands.holds(arm):
                self._plant.slip(arm)
                self._report("seen", event="fail_grasp", agent=arm, effect="the hand has slipped off")
        self._look_at_hands()

    def begin(self, tick: int, event: Begun) -> None:
        """A fault begins with this tick. Raises :class:`sim_server.process_deeds.Undone`."""
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
            self._proofs.see(seen.event)
        self._report("seen", event=seen.event.kind, **_target(seen.event), effect=seen.effect)

    def finish(self) -> None:
        """The run has come to its end: tell what is to be told of what went on until then."""
        self._look_at_hands()
        self._clock.edge.finish()
        self._plant.damage.finish()
        self._tell_news()

    def state(self) -> Snapshot:
        """Hands that will slip off, and that were made to let go."""
        return {
            "slips": [list(slip) for slip in self._slips],
            "letting_go": [[event.at_s, event.arm] for event in self._letting_go],
        }

    def restore(self, saved: Snapshot) -> None:
        """Go on from there."""
        self._slips = [(int(tick), str(arm)) for tick, arm in saved["slips"]]
        self._letting_go = [
            GraspSlip(kind="grasp_slip", at_s=float(at_s), arm=str(arm)) for at_s, arm in saved["letting_go"]
        ]


def _target(event: Event) -> dict[str, str]:
    """Whom an event is on, for the events' file."""
    if arm := getattr(event, "arm", None):
        whom = {"agent": str(arm)}
    else:
        whom = {"point": getattr(event, "point", None) or "centre_of_mass"}
    return whom | {"direction": event.direction} if isinstance(event, MessageEvent) else whom
