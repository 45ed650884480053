"""Which of a scenario's events have been seen to take effect: a run in which one has not proves nothing."""

from __future__ import annotations

from collections.abc import Iterable

from sim_server.faults.event import Event
from sim_server.snapshot import Snapshot, SnapshotError

OTHERS = {"sim_kill": "the simulator"}
"""Whom events are on that name nobody; all others are on the load."""


class Proofs:
    """The events of one run, each with whether it was ordered and whether its effect was seen.

    Args:
        events: of the scenario, in the order in which they happen.
    """

    def __init__(self, events: Iterable[Event]) -> None:
        self._events = list(events)
        self._ordered: set[int] = set()
        self._seen: set[int] = set()

    def order(self, event: Event) -> None:
        """It is done now. Of equal events the first that was not."""
        self._note(event, self._ordered)

    def see(self, event: Event) -> None:
        """Its effect has been seen; once more changes nothing but for an equal one that was ordered too."""
        self._note(event, self._seen, self._ordered)

    def _note(self, event: Event, book: set[int], among: set[int] | None = None) -> None:
        for number, each in enumerate(self._events):
            if each == event and number not in book and (among is None or number in among):
                book.add(number)
                return

    def missing(self) -> list[str]:
        """A sentence for every event without an effect that was seen, in their order."""
        return [
            f"{describe(event)} "
            + ("was not seen to take effect" if number in self._ordered else "was not done before the run's end")
            for number, event in enumerate(self._events)
            if number not in self._seen
        ]

    def state(self) -> Snapshot:
        """Numbers of those that were ordered, and seen."""
        return {"ordered": sorted(self._ordered), "seen": sorted(self._seen)}

    def restore(self, saved: Snapshot) -> None:
        """Go on from there."""
        ordered, seen = {int(number) for number in saved["ordered"]}, {int(number) for number in saved["seen"]}
        if not ordered | seen <= set(range(len(self._events))):
            raise SnapshotError(f"events: got numbers beyond the {len(self._events)} of the scenario")
        self._ordered, self._seen = ordered, seen


def describe(event: Event) -> str:
    """An event in words: its kind, on whom, and when."""
    whom = getattr(event, "agent", None) or getattr(event, "arm", None) or OTHERS.get(event.kind, "the load")
    return f"event {event.kind!r} of {whom} at {event.at_s:g} s"
