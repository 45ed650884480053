"""Whatever bytes come, a message or a refusal comes out, and the short way in says the same as the long way."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_strategies import MESSAGES, SAMPLES, body_of, every_message, judged, packed, text
from msgspec.structs import fields

from wire import PROTOCOL_VERSION
from wire.codec import SCHEMAS, _decode_the_long_way, decode_any, encode
from wire.errors import Reason, Refused
from wire.messages import Command, LeaderView, Message, State

# Whatever comes


@every_message
def test_a_flipped_bit_gives_a_message_or_a_refusal(kind: str) -> None:
    payload = encode(SAMPLES[kind])
    for place in range(len(payload)):
        for bit in range(8):
            flipped = bytearray(payload)
            flipped[place] ^= 1 << bit
            judged(bytes(flipped))


@settings(max_examples=300)
@given(st.binary(max_size=400))
def test_random_bytes_give_a_message_or_a_refusal(payload: bytes) -> None:
    judged(payload)


scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(st.characters(codec="utf-8"), max_size=20)
    | st.binary(max_size=20)
    | st.builds(msgpack.ExtType, st.integers(0, 127), st.binary(max_size=20))
)
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=8) | st.dictionaries(text(8), inner, max_size=8), max_leaves=20
)


@every_message
@settings(max_examples=20)
@given(data=st.data())
def test_any_value_in_any_field_gives_a_message_or_a_refusal(kind: str, data: st.DataObject) -> None:
    body = body_of(SAMPLES[kind])
    for name in data.draw(st.lists(st.sampled_from(sorted(body)), min_size=1, max_size=3)):
        body[name] = data.draw(values)
    judged(packed(body))


@settings(max_examples=100)
@given(values)
def test_any_value_gives_a_refusal_when_it_is_no_message(value: object) -> None:
    assert isinstance(judged(packed(value)), Refused)


EXAMPLES: dict[str, Message] = {
    "state": State("a1", 5, 5_000_000, (0.5,) * 7, (0.25,) * 7, (1.0,) * 7, (2.0,) * 6, 0.03, (0.5,) * 6),
    "command": Command("a1", 5, 1, (0.5,) * 7, (0.25,) * 3, 0.0, (1.0,) * 7, -0.5, 100),
    "leader_view": LeaderView(5, 5_000_000, (0.5,) * 3, (1.0, 0.0, 0.0, 0.0), (0.25,) * 3, (1.0,) * 3),
}
NAME_OF = {cls: name for name, (cls, _) in SCHEMAS.items()}

# The short way in: it accepts nothing that the long way does not, and says nothing else.


def outcome(way: Callable[[bytes], Message], payload: bytes) -> Message | Reason:
    try:
        return way(payload)
    except Refused as refusal:
        return refusal.reason


@given(st.one_of(*MESSAGES.values()))
def test_what_is_sent_is_one_plain_map(message: Message) -> None:
    """Bytes as any MessagePack library makes them: version and type, then the fields in order."""
    name, values = NAME_OF[type(message)], {field.name: getattr(message, field.name) for field in fields(message)}
    assert encode(message) == msgpack.packb({"v": PROTOCOL_VERSION, "type": name, **values})


@settings(max_examples=400)
@given(st.one_of(MESSAGES["state"], MESSAGES["command"], MESSAGES["leader_view"]), st.data())
def test_the_short_way_in_lets_nothing_else_in_than_the_long_way(message: Message, data: st.DataObject) -> None:
    payload = bytearray(encode(message))
    for _ in range(data.draw(st.integers(0, 3))):
        at = data.draw(st.integers(0, len(payload) - 1))
        match data.draw(st.sampled_from(["set", "cut", "insert"])):
            case "set":
                payload[at] = data.draw(st.integers(0, 255))
            case "cut":
                del payload[at : at + data.draw(st.integers(1, 9))]
            case _:
                payload[at:at] = data.draw(st.binary(max_size=9))
        if not payload:
            return
    # By repr, since nothing equals a number that is not one: neither way may let one in.
    assert repr(outcome(decode_any, bytes(payload))) == repr(outcome(_decode_the_long_way, bytes(payload)))


@given(st.one_of(MESSAGES["state"], MESSAGES["command"]), st.data())
def test_one_wrong_field_is_refused_both_ways_for_the_same_reason(message: Message, data: st.DataObject) -> None:
    body = msgpack.unpackb(encode(message), use_list=False)
    name = data.draw(st.sampled_from([key for key in body if key not in ("v", "type")]))
    body[name] = data.draw(
        st.sampled_from([None, True, -1, 2**63, 1.5, "x" * 41, (), (1.0,) * 17, (1, 2, 3), (math.nan,) * 3, {}, b"x"])
    )
    payload = msgpack.packb(body)
    assert repr(outcome(decode_any, payload)) == repr(outcome(_decode_the_long_way, payload))


@pytest.mark.parametrize("name", ["state", "command", "leader_view"])
def test_a_sender_may_order_its_fields_as_it_likes(name: str) -> None:
    message = EXAMPLES[name]
    body = msgpack.unpackb(encode(message), use_list=False)
    assert decode_any(msgpack.packb(dict(reversed(body.items())))) == message
