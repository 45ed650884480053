"""What all message faults share: whose messages, in which direction, how many of them, and how late they may come.

A fault gets the bytes of one message and gives back the bytes of none, one or several. What it draws depends on the
seed, the fault, the tick and the number of the message within it, and on nothing else: no stream goes on from tick to
tick, so that the same ticks are hit whatever else happens in a run.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from typing import ClassVar, Literal

import numpy as np

from sim_server.faults.event import Lasting, Probability
from sim_server.snapshot import Snapshot
from wire.codec import decode_any
from wire.errors import Refused

STREAM = 0xFA017
"""Keeps these draws apart from all others of the same seed."""

Direction = Literal["to", "from"]


class MessageEvent(Lasting):
    """A fault of the messages to one arm's agent (its states), or from it (its commands); or of the leader's."""

    arm: str
    """Its name, or ``leader``, whose messages are the views that it is sent and the pulls that come from it."""
    direction: Direction
    """Seen from the simulator: ``to`` the agent, or ``from`` it."""
    probability: Probability = 1.0
    """Of each message to be hit."""


class MessageEffect(ABC):
    """A message fault that goes on: see the module.

    Args:
        event: its settings.
        seed: the scenario's.
        number: of the fault in its run; each draws anew.
        end: the tick from which on messages pass untouched; None: never.
    """

    done: ClassVar[str] = ""
    """What has been done to the messages that were hit, in a word or two."""

    def __init__(self, event: MessageEvent, seed: int, number: int, end: int | None) -> None:
        self.event, self.number, self.end = event, number, end
        self._seed = seed
        self.messages = self.hit = 0
        """How many have come by, and how many of them were hit."""
        self.refused: Counter[str] = Counter()
        """Of those that were hit and sent on: why the decoder refuses them."""
        self.told = False
        """Whether it has been reported that it takes effect."""
        self._held: list[tuple[int, bytes]] = []
        self._tick, self._nth = -1, 0

    @abstractmethod
    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes] | None:
        """What becomes of a message that is to be hit: the messages that go on now; None if it cannot be hit."""

    def chosen(self, tick: int, rng: np.random.Generator) -> bool:
        """Whether this message is to be hit."""
        probability = self.event.probability
        return probability >= 1.0 or bool(rng.random() < probability)

    def through(self, payload: bytes, tick: int) -> list[bytes]:
        """The messages that go on now where this one came."""
        if self.has_ended(tick):
            return [payload]
        self._nth = self._nth + 1 if tick == self._tick else 0
        self._tick = tick
        self.messages += 1
        rng = np.random.default_rng([self._seed, STREAM, self.number, tick, self._nth])
        found = self.act(payload, tick, rng) if self.chosen(tick, rng) else None
        if found is None:
            return [payload]
        self.hit += 1
        return found

    def hold(self, payload: bytes, until: int) -> None:
        """Keep a message until that tick."""
        self._held.append((until, payload))

    def due(self, tick: int) -> list[bytes]:
        """Messages that were held until now, in the order in which they came."""
        found = [payload for until, payload in self._held if until <= tick]
        self._held = [each for each in self._held if each[0] > tick]
        return found

    def has_ended(self, tick: int) -> bool:
        """Whether messages of this tick pass untouched."""
        return self.end is not None and tick >= self.end

    def holds(self, tick: int) -> bool:
        """Whether a message that is held can still go out, in this tick or later."""
        return any(until >= tick for until, _ in self._held)

    @property
    def count(self) -> str:
        """What was done so far, in numbers."""
        text = f"{self.hit} of {self.messages} messages {self.done}"
        if self.refused:
            text += ": " + ", ".join(f"{times} refused as {reason}" for reason, times in sorted(self.refused.items()))
        return text

    def state(self) -> Snapshot:
        """Everything but the settings."""
        return {
            "messages": self.messages,
            "hit": self.hit,
            "refused": dict(self.refused),
            "told": self.told,
            "held": [list(each) for each in self._held],
        }

    def restore(self, saved: Snapshot) -> None:
        """Go on from there."""
        self.messages, self.hit, self.told = int(saved["messages"]), int(saved["hit"]), bool(saved["told"])
        self.refused = Counter({str(reason): int(times) for reason, times in saved["refused"].items()})
        self._held = [(int(until), bytes(payload)) for until, payload in saved["held"]]


class Corruption(MessageEffect):
    """A fault that spoils the bytes: counts what the decoder, which every receiver has, says of them."""

    def through(self, payload: bytes, tick: int) -> list[bytes]:
        before = self.hit
        found = super().through(payload, tick)
        if self.hit > before:
            for each in found:
                try:
                    decode_any(each)
                except Refused as refusal:
                    self.refused[str(refusal.reason)] += 1
        return found
