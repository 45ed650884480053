"""Messages that come late, by whole ticks of simulated time: all by as much, each by its own, or after the next one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from sim_server.faults.event import Count, Fault, Probability
from sim_server.faults.message import MessageEffect, MessageEvent
from sim_server.snapshot import Snapshot


class Delay(MessageEvent):
    """Every message comes so much later, in order."""

    kind: Literal["delay"]
    delay_ticks: Count = 2


class Jitter(MessageEvent):
    """Each message comes later by a number of ticks drawn evenly from 0 to ``jitter_ticks``, so that some overtake."""

    kind: Literal["jitter"]
    jitter_ticks: Count = 3


class Reorder(MessageEvent):
    """A message waits until the next one has gone, and follows it."""

    kind: Literal["reorder"]
    probability: Probability = 0.1


class DelayEffect(MessageEffect):
    done = "late"
    event: Delay

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes]:
        self.hold(payload, tick + self.event.delay_ticks)
        return []


class JitterEffect(MessageEffect):
    done = "late"
    event: Jitter

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes] | None:
        late = int(rng.integers(0, self.event.jitter_ticks, endpoint=True))
        if not late:
            return None
        self.hold(payload, tick + late)
        return []


class ReorderEffect(MessageEffect):
    done = "sent after the next"
    _waits: bytes | None = None

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes]:
        self._waits = payload
        return []

    def chosen(self, tick: int, rng: np.random.Generator) -> bool:
        return self._waits is None and super().chosen(tick, rng)

    def through(self, payload: bytes, tick: int) -> list[bytes]:
        waits = self._waits
        found = super().through(payload, tick)
        if waits is None:
            return found
        self._waits = None
        return [*found, waits]

    def due(self, tick: int) -> list[bytes]:
        """One that waits goes by itself if none has come by the fault's end: the leader's come every so many ticks."""
        found = super().due(tick)
        if self._waits is not None and self.end is not None and tick > self.end:
            found.append(self._waits)
            self._waits = None
        return found

    def holds(self, tick: int) -> bool:
        return self._waits is not None and self.end is not None and tick <= self.end + 1

    def state(self) -> Snapshot:
        return super().state() | {"waits": self._waits}

    def restore(self, saved: Snapshot) -> None:
        super().restore(saved)
        self._waits = saved["waits"]


FAULTS = (
    Fault("delay", "message", Delay, "comes `delay_ticks` later, in order", "how many came late"),
    Fault(
        "jitter",
        "message",
        Jitter,
        "comes 0 to `jitter_ticks` later, drawn evenly; some overtake others",
        "how many came late",
    ),
    Fault("reorder", "message", Reorder, "waits, and goes right after the next one", "how many went after the next"),
)
EFFECTS: Mapping[type[MessageEvent], type[MessageEffect]] = {
    Delay: DelayEffect,
    Jitter: JitterEffect,
    Reorder: ReorderEffect,
}
