"""What observers are told: every recorded row and every event. It costs a look at a flag while nobody listens."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import numpy as np

from sim_server.layout import Array
from sim_server.tally import OBSERVERS, CountedPublisher, Tallies
from sim_server.world import ArmIds
from wire.codec import encode
from wire.keys import Keys
from wire.link import Link
from wire.messages import Event, Row

LONGEST_DETAILS = 4000
"""Characters of an event's details; longer ones are left out. None of ours is."""


class TruthFeed:
    """Publishes for observers; they can say nothing here, and nobody waits for them."""

    def __init__(self, link: Link, keys: Keys, tallies: Tallies) -> None:
        self._rows = CountedPublisher(link.publisher(keys.rows), tallies.of(OBSERVERS, keys.rows, "to"))
        self._events = CountedPublisher(link.publisher(keys.events), tallies.of(OBSERVERS, keys.events, "to"))

    def row(self, parts: Sequence[Array], tick_ns: int, arms: Mapping[str, ArmIds]) -> None:
        """A row as it goes to the trace.

        Args:
            parts: the values of its columns in pieces, the first of which is [tick, time].
            tick_ns: wall time that the tick took.
            arms: those that are there, in the order of the columns.
        """
        if not self._rows.matched():
            return
        values = np.concatenate(parts[1:]).astype("<f8", copy=False).tobytes()
        struts = " ".join(str(ids.strut + 1) for ids in arms.values())
        self._rows.put(encode(Row(int(parts[0][0]), tick_ns, " ".join(arms), struts, values)))

    def event(self, tick: int, time_s: float, kind: str, details: Mapping[str, object]) -> None:
        """An event as it goes to the events file."""
        if self._events.matched():
            text = json.dumps(details)
            self._events.put(encode(Event(tick, time_s, kind, text if len(text) <= LONGEST_DETAILS else "{}")))
