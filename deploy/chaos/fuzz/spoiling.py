"""Ways to make of a real message one that no receiver may believe.

Most are wrong whatever the receiver knows. Of the others (wrong bits, wrong bytes) some still are whole messages by
chance; who sends them asks :mod:`deploy.chaos.fuzz.whole` first.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from typing import Any

import msgpack

from wire import PROTOCOL_VERSION
from wire.codec import MAX_BYTES

Draws = random.Random
Body = dict[str, Any]
Way = Callable[[bytes, Draws], "bytes | None"]
"""Makes another message of one; None if it has nothing that could be spoiled in this way."""

NO_NUMBERS: tuple[Any, ...] = (None, True, "1.0", b"\x00", [], {}, [[1.0]], msgpack.ExtType(5, b"x"))
NO_COUNTS: tuple[Any, ...] = (*NO_NUMBERS, 1.0, -1, -(2**63), 2**63, 2**64 - 1)
NO_TEXTS: tuple[Any, ...] = (None, False, 7, 1.5, b"a1", ["a1"], {"a1": 1}, "x" * 5000)
NO_VECTORS: tuple[Any, ...] = (None, True, 1.0, "0.0", b"\x00" * 56, {}, {"0": 0.0}, [], [0.0] * 63)
NOT_FINITE = (math.nan, math.inf, -math.inf)
DEEPEST = 3000
"""Arrays within arrays: more than Python's own stack takes."""
NAMES = ("arm", "name", "run", "arm_model", "digest", "role")
"""Fields that say who it is; with another word in one of them a message is somebody else's."""


def cut_off(payload: bytes, draws: Draws) -> bytes:
    return payload[: draws.randrange(len(payload))]


def run_on(payload: bytes, draws: Draws) -> bytes:
    return payload + draws.randbytes(draws.randint(1, 40))


def random_bytes(payload: bytes, draws: Draws) -> bytes:
    return draws.randbytes(draws.randint(0, 400))


def too_long(payload: bytes, draws: Draws) -> bytes:
    return payload + bytes(draws.randint(MAX_BYTES + 1, 3 * MAX_BYTES))


def nested(payload: bytes, draws: Draws) -> bytes:
    deep = bytes([draws.choice((0x91, 0x81))]) * draws.randint(1, DEEPEST)
    if draws.random() < 0.5:
        return deep
    body = _body(payload)
    name = _field(body, draws)
    return bytes([0x81]) + msgpack.packb(name) + deep + b"\xc0"


def wrong_type(payload: bytes, draws: Draws) -> bytes:
    body = _body(payload)
    name = _field(body, draws)
    value = body[name]
    wrong = (
        NO_TEXTS if isinstance(value, str)
        else NO_VECTORS if isinstance(value, list)
        else NO_COUNTS if isinstance(value, int)
        else NO_NUMBERS
    )  # fmt: skip
    body[name] = draws.choice(wrong)
    return _packed(body)


def not_finite(payload: bytes, draws: Draws) -> bytes | None:
    body = _body(payload)
    numbers = [name for name, value in body.items() if isinstance(value, float | list)]
    if not numbers:
        return None
    name = draws.choice(numbers)
    if isinstance(body[name], list):
        body[name][draws.randrange(len(body[name]))] = draws.choice(NOT_FINITE)
    else:
        body[name] = draws.choice(NOT_FINITE)
    return _packed(body)


def wrong_length(payload: bytes, draws: Draws) -> bytes | None:
    body = _body(payload)
    vectors = [name for name, value in body.items() if isinstance(value, list)]
    if not vectors:
        return None
    name = draws.choice(vectors)
    right = len(body[name])
    body[name] = [0.5] * draws.choice([length for length in range(65) if length != right])
    return _packed(body)


def field_missing(payload: bytes, draws: Draws) -> bytes:
    body = _body(payload)
    del body[draws.choice(list(body))]
    return _packed(body)


def field_too_many(payload: bytes, draws: Draws) -> bytes:
    return _packed(
        _body(payload) | {draws.choice(("goal", "load", "arms", "", "Tick")): draws.choice((None, 1.0, "x"))}
    )


def other_version(payload: bytes, draws: Draws) -> bytes:
    versions = (0, PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1, -1, 2**40, True, None, str(PROTOCOL_VERSION), 1.0)
    return _packed(_body(payload) | {"v": draws.choice(versions)})


def no_such_kind(payload: bytes, draws: Draws) -> bytes:
    return _packed(_body(payload) | {"type": draws.choice(("", "commands", "State", None, 7, ["command"], b"state"))})


def somebody_elses(payload: bytes, draws: Draws) -> bytes | None:
    body = _body(payload)
    names = [name for name in NAMES if name in body]
    if not names:
        return None
    name = draws.choice(names)
    words = ("follower", "leader") if name == "role" else ("a1", "a2", "a77", "x" * 40, "leader")
    body[name] = draws.choice([word for word in words if word != body[name]])
    return _packed(body)


def wrong_bits(payload: bytes, draws: Draws) -> bytes:
    spoiled = bytearray(payload)
    for place in draws.sample(range(8 * len(payload)), draws.randint(1, 8)):
        spoiled[place // 8] ^= 1 << place % 8
    return bytes(spoiled)


def wrong_bytes(payload: bytes, draws: Draws) -> bytes:
    spoiled = bytearray(payload)
    for _ in range(draws.randint(1, 3)):
        at = draws.randrange(len(spoiled) + 1)
        spoiled[at : at + draws.randint(0, 4)] = draws.randbytes(draws.randint(0, 4))
    return bytes(spoiled)


SURELY: Mapping[str, Way] = {
    "cut off": cut_off,
    "runs on": run_on,
    "random bytes": random_bytes,
    "too long": too_long,
    "nested": nested,
    "a field of another type": wrong_type,
    "not finite": not_finite,
    "a vector of another length": wrong_length,
    "a field missing": field_missing,
    "a field too many": field_too_many,
    "another version": other_version,
    "no such kind": no_such_kind,
    "somebody else's name": somebody_elses,
}
"""Whoever gets it, and whenever: it does not fit."""
PERHAPS: Mapping[str, Way] = {"wrong bits": wrong_bits, "wrong bytes": wrong_bytes}
"""What comes out may make sense."""


def changed(payload: bytes, **values: object) -> bytes:
    """The message with other values in these fields, those that it has."""
    body = _body(payload)
    return _packed(body | {name: value for name, value in values.items() if name in body})


def _body(payload: bytes) -> Body:
    body: Body = msgpack.unpackb(payload)
    return body


def _packed(body: Body) -> bytes:
    packed: bytes = msgpack.packb(body)
    return packed


def _field(body: Body, draws: Draws) -> str:
    return draws.choice([name for name in body if name not in ("v", "type")])
