"""What observers are told: every recorded row and every event. While nobody listens it costs a look at a flag.

Another thread puts it on the wire: an observer that does not read, such as one that is stopped, holds a put up for a
millisecond before it is dropped, and no tick shall wait for that.
"""

from __future__ import annotations

import json
import queue
import threading
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
MOST_WAITING = 400
"""Rows on their way, two simulated seconds of the usual 200 a second. Further ones are dropped: this is no trace."""
FAREWELL_S = 1.0


class TruthFeed:
    """Publishes for observers; they can say nothing here, and nobody waits for them.

    Its thread begins with the first thing that somebody hears, and ends with :meth:`close` or the process.
    """

    def __init__(self, link: Link, keys: Keys, tallies: Tallies) -> None:
        self._rows = CountedPublisher(link.publisher(keys.rows), tallies.of(OBSERVERS, keys.rows, "to"))
        self._events = CountedPublisher(link.publisher(keys.events), tallies.of(OBSERVERS, keys.events, "to"))
        self._waiting: queue.SimpleQueue[Row | Event | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def row(self, parts: Sequence[Array], tick_ns: int, arms: Mapping[str, ArmIds]) -> None:
        """A row as it goes to the trace.

        Args:
            parts: the values of its columns in pieces, the first of which is [tick, time].
            tick_ns: wall time that the tick took.
            arms: those that are there, in the order of the columns.
        """
        if self._rows.matched() and self._waiting.qsize() < MOST_WAITING:
            values = np.concatenate(parts[1:]).astype("<f8", copy=False).tobytes()
            struts = " ".join(str(ids.strut + 1) for ids in arms.values())
            self._hand_over(Row(int(parts[0][0]), tick_ns, " ".join(arms), struts, values))

    def event(self, tick: int, time_s: float, kind: str, details: Mapping[str, object]) -> None:
        """An event as it goes to the events file."""
        if self._events.matched():
            text = json.dumps(details)
            self._hand_over(Event(tick, time_s, kind, text if len(text) <= LONGEST_DETAILS else "{}"))

    def close(self) -> None:
        """Nothing more comes. What is on its way gets a moment."""
        if self._thread is not None:
            self._waiting.put(None)
            self._thread.join(FAREWELL_S)

    def _hand_over(self, message: Row | Event) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._publish, name="truth", daemon=True)
            self._thread.start()
        self._waiting.put(message)

    def _publish(self) -> None:
        while (message := self._waiting.get()) is not None:
            publisher = self._rows if isinstance(message, Row) else self._events
            publisher.put(encode(message))
