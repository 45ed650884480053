"""Messages to bytes and back: a MessagePack map with string keys, every field typed, checked and finite.

``{"v": 1, "type": "state", ...fields}``. Nothing that fails a check gets past :func:`decode`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from operator import attrgetter
from typing import Any, TypeVar, cast, get_type_hints

import msgpack
import msgspec

from wire import PROTOCOL_VERSION
from wire.errors import Reason, Refused
from wire.messages import (
    MAX_INT,
    MAX_JOINTS,
    Command,
    Deed,
    Done,
    End,
    Event,
    Goodbye,
    Hello,
    LeaderForce,
    LeaderView,
    Leaving,
    Message,
    Order,
    Progress,
    Refusal,
    Row,
    State,
    Vector,
    Welcome,
)

MAX_BYTES = 8192
"""Longest message that is looked at. What an agent sends or gets is below 1500; a row of 16 arms for observers 7600."""

DOUBLE = 8
"""Bytes of a float64."""

Check = Callable[[str, Any], Any]
M = TypeVar("M", bound=Message)


def _shown(value: Any) -> str:
    """A value for the text of a refusal. Never a nested one: it may nest deeper than ``repr`` can follow."""
    return type(value).__name__ if isinstance(value, tuple | dict) else repr(value)


def _integer(name: str, value: Any) -> int:
    if type(value) is not int:
        raise Refused(Reason.FIELD_TYPE, name, type(value).__name__, "an integer")
    if not 0 <= value <= MAX_INT:
        raise Refused(Reason.RANGE, name, value, "0 to 2^63 - 1")
    return value


def _number(name: str, value: Any) -> float:
    if type(value) is not float and type(value) is not int:
        raise Refused(Reason.FIELD_TYPE, name, type(value).__name__, "a number")
    if not isfinite(value):
        raise Refused(Reason.NOT_FINITE, name, value, "a finite number")
    return float(value)


def _vector(least: int, most: int) -> Check:
    expected = f"{least} numbers" if least == most else f"{least} to {most} numbers"

    def check(name: str, value: Any) -> Vector:
        if type(value) is not tuple:
            raise Refused(Reason.FIELD_TYPE, name, type(value).__name__, f"an array of {expected}")
        if not least <= len(value) <= most:
            raise Refused(Reason.LENGTH, name, len(value), expected)
        for number in value:
            if type(number) is not float:
                return tuple(_number(name, element) for element in value)
            if not isfinite(number):
                raise Refused(Reason.NOT_FINITE, name, number, "finite numbers")
        return cast(Vector, value)

    return check


def _text(longest: int) -> Check:
    def check(name: str, value: Any) -> str:
        if type(value) is not str:
            raise Refused(Reason.FIELD_TYPE, name, type(value).__name__, "text")
        if len(value) > longest:
            raise Refused(Reason.LENGTH, name, len(value), f"at most {longest} characters")
        return value

    return check


def _one_of(*allowed: str) -> Check:
    def check(name: str, value: Any) -> str:
        if type(value) is not str:
            raise Refused(Reason.FIELD_TYPE, name, type(value).__name__, "text")
        if value not in allowed:
            raise Refused(Reason.RANGE, name, repr(value), " or ".join(allowed))
        return value

    return check


def _doubles(name: str, value: Any) -> bytes:
    """Numbers as bytes, eight each. They may be NaN or infinite: physics that failed is recorded too."""
    if type(value) is not bytes:
        raise Refused(Reason.FIELD_TYPE, name, type(value).__name__, "bytes")
    if len(value) % DOUBLE:
        raise Refused(Reason.LENGTH, name, len(value), f"a multiple of {DOUBLE} bytes")
    return value


def _points(name: str, value: Any) -> dict[str, Vector]:
    if type(value) is not dict:
        raise Refused(Reason.FIELD_TYPE, name, type(value).__name__, "a map")
    return {_text(40)(name, key): _vector(3, 3)(f"{name}.{key}", point) for key, point in value.items()}


_joints = _vector(1, MAX_JOINTS)
_three = _vector(3, 3)

SCHEMAS: Mapping[str, tuple[type[Any], Mapping[str, Check]]] = {
    "hello": (
        Hello,
        {
            "role": _one_of("follower", "leader"),
            "run": _text(40),
            "name": _text(40),
            "arm_model": _text(40),
            "digest": _text(64),
            "pid": _integer,
            "host": _text(255),
        },
    ),
    "welcome": (
        Welcome,
        {
            "lease": _integer,
            "clock": _one_of("lock-step", "real-time"),
            "control_period_ns": _integer,
            "points": _points,
            "force_max_N": _number,
            "carry_height_m": _number,
            "strut": _vector(7, 7),
        },
    ),
    "refusal": (Refusal, {"reason": _text(40), "text": _text(1000)}),
    "state": (
        State,
        {
            "arm": _text(40),
            "tick": _integer,
            "time_ns": _integer,
            "q": _joints,
            "qd": _joints,
            "tau": _joints,
            "wrench": _vector(6, 6),
            "grip_m": _number,
            "odometry": _vector(6, 6),
        },
    ),
    "command": (
        Command,
        {
            "arm": _text(40),
            "tick": _integer,
            "lease": _integer,
            "torque": _joints,
            "base_force": _three,
            "grip_m": _number,
            "stiffness": _joints,
            "residual_W": _number,
            "step_ns": _integer,
        },
    ),
    "leader_view": (
        LeaderView,
        {
            "tick": _integer,
            "time_ns": _integer,
            "position": _three,
            "quat_wxyz": _vector(4, 4),
            "linear_velocity": _three,
            "angular_velocity": _three,
        },
    ),
    "leader_force": (LeaderForce, {"tick": _integer, "lease": _integer, "point": _text(40), "force": _three}),
    "leaving": (Leaving, {"name": _text(40), "lease": _integer}),
    "goodbye": (Goodbye, {"name": _text(40), "lease": _integer}),
    "end": (End, {"kind": _one_of("over", "lost"), "reason": _text(1000)}),
    "progress": (
        Progress,
        {
            "phase": _one_of("waiting", "running", "ended"),
            "waiting_for": _text(400),
            "tick": _integer,
            "ticks": _integer,
            "time_s": _number,
            "real_time_factor": _number,
            "tilt_deg": _number,
            "goal_distance_m": _number,
            "missed_ticks": _integer,
            "age_max_ticks": _integer,
        },
    ),
    "row": (
        Row,
        {"tick": _integer, "tick_ns": _integer, "arms": _text(400), "struts": _text(400), "values": _doubles},
    ),
    "event": (Event, {"tick": _integer, "time_s": _number, "kind": _text(40), "details": _text(4000)}),
    "order": (Order, {"verb": _one_of("stop", "join"), "strut": _integer}),
    "deed": (
        Deed,
        {
            "number": _integer,
            "verb": _one_of("kill", "stop", "continue", "start", "leave", "hang", "slow", "disconnect", "reconnect"),
            "agent": _text(40),
        },
    ),
    "done": (Done, {"number": _integer, "problem": _text(1000)}),
}
"""Every message: its name on the wire, its class, and each field with its check. docs/wire.md is its translation."""

_TYPE_OF: Mapping[type[Any], tuple[str, tuple[str, ...]]] = {
    cls: (name, tuple(fields)) for name, (cls, fields) in SCHEMAS.items()
}


def _head(name: str, fields: int) -> bytes:
    """How a message begins: a map of so many fields (fewer than 16), the first two of which are version and type."""
    empty = msgpack.packb({"v": PROTOCOL_VERSION, "type": name})
    return bytes([empty[0] + fields]) + empty[1:]


_HEADS: Mapping[type[Any], bytes] = {cls: _head(name, len(fields)) for cls, (name, fields) in _TYPE_OF.items()}
_encode_fields = msgspec.msgpack.Encoder().encode


class _Quick:
    """The short way in for one class that comes every tick: bytes just as :func:`encode` makes them, read and checked
    in one call. Everything else, and every doubt, goes the long way, which knows what to say. Nothing passes here that
    does not pass there (tested)."""

    def __init__(self, cls: type[Any]) -> None:
        self._head = _HEADS[cls]
        self._decode = msgspec.msgpack.Decoder(cls).decode
        hints = get_type_hints(cls).items()
        self._vectors = attrgetter(*(name for name, kind in hints if kind == Vector))
        self._numbers = [attrgetter(name) for name, kind in hints if kind is float]

    def decode(self, payload: bytes) -> Any:
        """The message, or None where the long way has to be taken."""
        if not payload.startswith(self._head) or len(payload) > MAX_BYTES:
            return None
        try:  # the head counts the fields and the decoder wants every one, so there are no others
            message = self._decode(payload)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return None
        for vector in self._vectors(message):
            if not isfinite(sum(vector)):  # a sum is finite only if all its terms are
                return None
        for number in self._numbers:
            if not isfinite(number(message)):
                return None
        return message


def encode(message: Message) -> bytes:
    """The bytes of a message. The values are not checked here: the receiver does that."""
    return _HEADS[type(message)] + _encode_fields(message)[1:]  # the head replaces the one byte that counts the fields


def decode(payload: bytes, wanted: type[M]) -> M:
    """The message in ``payload``, which must be of the class ``wanted``.

    Raises:
        Refused: it is not, with the reason, the field, what came and what would have been right.
    """
    quick = _QUICK.get(wanted)
    message = quick.decode(payload) if quick is not None else None
    if message is None:
        message = decode_any(payload)
        if type(message) is not wanted:
            raise Refused(Reason.TYPE, "type", _TYPE_OF[type(message)][0], _TYPE_OF[wanted][0])
    return cast(M, message)


def decode_any(payload: bytes) -> Message:
    """The message in ``payload``, of whichever class. Raises :class:`Refused` as :func:`decode` does."""
    for quick in _QUICK.values():
        message = quick.decode(payload)
        if message is not None:
            return cast(Message, message)
    return _decode_the_long_way(payload)


def _decode_the_long_way(payload: bytes) -> Message:
    if len(payload) > MAX_BYTES:
        raise Refused(Reason.LENGTH, "message", len(payload), f"at most {MAX_BYTES} bytes")
    try:
        body = msgpack.unpackb(payload, use_list=False, max_array_len=64, max_map_len=64)
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError) as error:
        raise Refused(Reason.MALFORMED, "message", f"{type(error).__name__}: {error}", "one MessagePack map") from None
    if type(body) is not dict:
        raise Refused(Reason.MALFORMED, "message", type(body).__name__, "one MessagePack map")
    version = body.pop("v", None)
    if type(version) is not int or version != PROTOCOL_VERSION:
        raise Refused(
            Reason.VERSION,
            "protocol version",
            _shown(version),
            PROTOCOL_VERSION,
            "Install the same release on both sides",
        )
    kind = body.pop("type", None)
    schema = SCHEMAS.get(kind) if type(kind) is str else None
    if schema is None:
        raise Refused(Reason.TYPE, "type", _shown(kind), ", ".join(SCHEMAS))
    cls, checks = schema
    values = []
    for name, check in checks.items():
        try:
            value = body.pop(name)
        except KeyError:
            raise Refused(Reason.MISSING_FIELD, f"{kind}.{name}", "nothing", "the field") from None
        values.append(check(name, value))
    if body:
        raise Refused(Reason.UNKNOWN_FIELD, f"{kind}.{next(iter(body))}", "", "no such field")
    return cast(Message, cls(*values))


_QUICK: Mapping[type[Any], _Quick] = {cls: _Quick(cls) for cls in (State, Command, LeaderView)}
