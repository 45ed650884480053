"""Messages that do not come, one by one or several in a row, and messages that come twice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from sim_server.faults.event import Count, Fault, Probability
from sim_server.faults.message import MessageEffect, MessageEvent
from sim_server.snapshot import Snapshot


class Loss(MessageEvent):
    """Messages are lost, each with the same probability."""

    kind: Literal["loss"]
    probability: Probability = 0.1


class BurstLoss(MessageEvent):
    """Messages are lost for several ticks in a row."""

    kind: Literal["burst_loss"]
    probability: Probability = 0.02
    """Of each message, outside a burst, to be the first of one."""
    burst_ticks: Count = 10


class Duplicate(MessageEvent):
    """Messages come twice, one right after the other."""

    kind: Literal["duplicate"]


class LossEffect(MessageEffect):
    done = "lost"

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes]:
        return []


class BurstLossEffect(LossEffect):
    event: BurstLoss
    _until = 0

    def chosen(self, tick: int, rng: np.random.Generator) -> bool:
        if tick < self._until:
            return True
        if not super().chosen(tick, rng):
            return False
        self._until = tick + self.event.burst_ticks
        return True

    def state(self) -> Snapshot:
        return super().state() | {"until": self._until}

    def restore(self, saved: Snapshot) -> None:
        super().restore(saved)
        self._until = int(saved["until"])


class DuplicateEffect(MessageEffect):
    done = "doubled"

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes]:
        return [payload, payload]


FAULTS = (
    Fault("loss", "message", Loss, "is lost", "how many were lost"),
    Fault(
        "burst_loss",
        "message",
        BurstLoss,
        "begins, with `probability`, a burst of `burst_ticks` in which all are lost",
        "how many were lost",
    ),
    Fault("duplicate", "message", Duplicate, "comes twice", "how many were doubled"),
)
EFFECTS: Mapping[type[MessageEvent], type[MessageEffect]] = {
    Loss: LossEffect,
    BurstLoss: BurstLossEffect,
    Duplicate: DuplicateEffect,
}
