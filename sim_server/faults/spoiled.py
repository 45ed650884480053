"""Messages whose bytes are not what was sent: cut off, with wrong bits, with a NaN, with another arm's name, or old.

All of them go to the receiver's own decoder and its own rules, which refuse them, or not.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from msgspec import structs
from pydantic import Field

from sim_server.faults.event import Count, Fault
from sim_server.faults.message import Corruption, MessageEffect, MessageEvent
from sim_server.reception import LEADER
from sim_server.snapshot import Snapshot
from wire.codec import decode_any, encode
from wire.errors import Refused
from wire.messages import Command, LeaderForce, LeaderView, State, Vector


class Stale(MessageEvent):
    """In place of each message comes the one of ``age_ticks`` messages before; in the fault's first, its first one."""

    kind: Literal["stale"]
    age_ticks: Count = 5


class Truncate(MessageEvent):
    """Messages end early, at a byte that is drawn."""

    kind: Literal["truncate"]


class BitFlip(MessageEvent):
    """Bits of a message are turned round, at places that are drawn."""

    kind: Literal["bit_flip"]
    bits: Count = 1


class NotANumber(MessageEvent):
    """One number of a message is NaN: a joint position of a state, a torque of a command, a coordinate of the load in
    a view, a component of a pull; which one is drawn."""

    kind: Literal["nan"]


class WrongArm(MessageEvent):
    """Messages bear the name of another arm."""

    kind: Literal["wrong_arm"]
    name: Annotated[str, Field(pattern=r"^a[1-9][0-9]{0,2}$")]
    """Whose."""

    def problem(self) -> tuple[str, str] | None:
        if self.arm == LEADER:
            return "arm", "the leader's messages bear no arm's name; expected an arm"
        return None


class StaleEffect(MessageEffect):
    done = "replaced by an older one"

    def __init__(self, event: Stale, seed: int, number: int, end: int | None) -> None:
        super().__init__(event, seed, number, end)
        self._before: deque[bytes] = deque(maxlen=event.age_ticks + 1)

    def through(self, payload: bytes, tick: int) -> list[bytes]:
        self._before.append(payload)
        return super().through(payload, tick)

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes] | None:
        return [self._before[0]] if len(self._before) > 1 else None

    def state(self) -> Snapshot:
        return super().state() | {"before": list(self._before)}

    def restore(self, saved: Snapshot) -> None:
        super().restore(saved)
        self._before.extend(saved["before"])


class TruncateEffect(Corruption):
    done = "cut off"

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes] | None:
        payload = timeless(payload)
        return [payload[: int(rng.integers(1, len(payload)))]] if len(payload) > 1 else None


class BitFlipEffect(Corruption):
    done = "with wrong bits"
    event: BitFlip

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes] | None:
        payload = timeless(payload)
        places = rng.choice(8 * len(payload), size=min(self.event.bits, 8 * len(payload)), replace=False)
        spoiled = bytearray(payload)
        for place in places.tolist():
            spoiled[place // 8] ^= 1 << place % 8
        return [bytes(spoiled)]


class NotANumberEffect(Corruption):
    done = "with a NaN"

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes] | None:
        message = _whole(payload)
        if isinstance(message, State):
            return [encode(structs.replace(message, q=_with_nan(message.q, rng)))]
        if isinstance(message, Command):
            return [encode(structs.replace(message, torque=_with_nan(message.torque, rng), step_ns=0))]
        if isinstance(message, LeaderView):
            return [encode(structs.replace(message, position=_with_nan(message.position, rng)))]
        if isinstance(message, LeaderForce):
            return [encode(structs.replace(message, force=_with_nan(message.force, rng)))]
        return None


class WrongArmEffect(Corruption):
    done = "with another arm's name"
    event: WrongArm

    def act(self, payload: bytes, tick: int, rng: np.random.Generator) -> list[bytes] | None:
        message = _whole(timeless(payload))
        if not isinstance(message, State | Command):
            return None
        return [encode(structs.replace(message, arm=self.event.name))]


def timeless(payload: bytes) -> bytes:
    """A command without the wall time that it reports, whose size and bits no seed decides; anything else as it is."""
    message = _whole(payload)
    return encode(structs.replace(message, step_ns=0)) if isinstance(message, Command) else payload


def _whole(payload: bytes) -> State | Command | LeaderView | LeaderForce | None:
    """The message, or None if another fault has spoiled it already."""
    try:
        message = decode_any(payload)
    except Refused:
        return None
    return message if isinstance(message, State | Command | LeaderView | LeaderForce) else None


def _with_nan(vector: Vector, rng: np.random.Generator) -> Vector:
    place = int(rng.integers(len(vector)))
    return (*vector[:place], float("nan"), *vector[place + 1 :])


FAULTS = (
    Fault(
        "stale",
        "message",
        Stale,
        "is replaced by the one `age_ticks` before it, or by the first of the fault",
        "how many were replaced",
    ),
    Fault("truncate", "message", Truncate, "is cut off at a drawn byte", "how many were cut off; refused as what"),
    Fault(
        "bit_flip",
        "message",
        BitFlip,
        "has `bits` wrong bits at drawn places; what still makes sense is believed",
        "how many had wrong bits; refused as what",
    ),
    Fault(
        "nan",
        "message",
        NotANumber,
        "has a NaN for one joint position (state) or torque (command); of the leader's, for a coordinate or a force",
        "how many had a NaN; refused as what",
    ),
    Fault("wrong_arm", "message", WrongArm, "bears the name `name`", "how many bore it"),
)
EFFECTS: Mapping[type[MessageEvent], type[MessageEffect]] = {
    Stale: StaleEffect,
    Truncate: TruncateEffect,
    BitFlip: BitFlipEffect,
    NotANumber: NotANumberEffect,
    WrongArm: WrongArmEffect,
}
