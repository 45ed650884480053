"""Messages to bytes and back: what is sent arrives, and what does not fit is refused for the right reason."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_strategies import MESSAGES, SAMPLES, body_of, every_message, judged, packed, refusal_of
from msgspec.structs import fields

from wire import PROTOCOL_VERSION
from wire.codec import MAX_BYTES, SCHEMAS, decode, decode_any, encode
from wire.errors import Reason, Refused
from wire.messages import MAX_JOINTS, Message, Vector

FIXED_LENGTH = {
    "wrench": 6,
    "base_force": 3,
    "force": 3,
    "position": 3,
    "quat_wxyz": 4,
    "linear_velocity": 3,
    "angular_velocity": 3,
    "odometry": 6,
    "strut": 7,
}
"""Vectors that are as long for every arm; all others have one number per joint."""

LONGEST_TEXT = {
    ("hello", "digest"): 64,
    ("hello", "host"): 255,
    ("refusal", "text"): 1000,
    ("end", "reason"): 1000,
    ("progress", "waiting_for"): 400,
    ("row", "arms"): 400,
    ("row", "struts"): 400,
    ("event", "details"): 4000,
    ("done", "problem"): 1000,
}
"""All other texts have at most 40 characters."""


# What is sent arrives


def test_every_message_of_the_wire_is_tried_here() -> None:
    assert set(MESSAGES) == set(SAMPLES) == set(SCHEMAS)
    assert {type(message) for message in SAMPLES.values()} == set(get_args(Message))


@every_message
def test_a_schema_has_its_class_s_fields_in_their_order(kind: str) -> None:
    cls, checks = SCHEMAS[kind]
    assert list(checks) == [field.name for field in fields(cls)]


@every_message
@settings(max_examples=40)
@given(data=st.data())
def test_a_message_survives_the_wire_unchanged(kind: str, data: st.DataObject) -> None:
    message = data.draw(MESSAGES[kind])
    payload = encode(message)
    arrived = decode(payload, type(message))
    assert arrived == message
    assert encode(arrived) == payload, "the same to the bit: the sign of a zero too"
    assert len(payload) <= MAX_BYTES


@every_message
def test_a_message_is_a_map_of_version_type_and_fields(kind: str) -> None:
    body = body_of(SAMPLES[kind])
    assert encode(SAMPLES[kind]) == packed(body)
    assert decode_any(packed(dict(reversed(body.items())))) == SAMPLES[kind], "in any order"


@every_message
def test_whole_numbers_for_floats_are_accepted_and_become_floats(kind: str) -> None:
    """A follower's packer may write 0.0 as 0."""
    body = body_of(SAMPLES[kind])
    for name, hint in hints(kind).items():
        if hint is float:
            body[name] = 3
        elif hint == Vector:
            body[name] = [3 if k % 2 else 3.0 for k in range(len(body[name]))]
        elif get_origin(hint) is dict:
            body[name] = {"front": [1, 2, 3]}
    message = decode_any(packed(body))
    for name, hint in hints(kind).items():
        value = getattr(message, name)
        if hint is float:
            assert type(value) is float
            assert value == 3.0
        elif hint == Vector:
            assert [type(number) for number in value] == [float] * len(value)
            assert set(value) == {3.0}
        elif get_origin(hint) is dict:
            assert repr(value["front"]) == "(1.0, 2.0, 3.0)"


# What does not fit is refused, and why


def hints(kind: str) -> dict[str, Any]:
    return get_type_hints(SCHEMAS[kind][0])


NOT_FINITE = (math.nan, math.inf, -math.inf)


def wrong(reason: Reason, *values: Any) -> list[tuple[Any, Reason]]:
    return [(value, reason) for value in values]


def misfits(kind: str, name: str, hint: Any) -> Iterator[tuple[Any, Reason]]:
    """Values that the field must not have, each with the reason."""
    extension = msgpack.ExtType(5, b"x")
    yield from wrong(Reason.FIELD_TYPE, None, True, False, extension, msgpack.Timestamp(1))
    yield b"a1", Reason.LENGTH if hint is bytes else Reason.FIELD_TYPE
    good = getattr(SAMPLES[kind], name)
    if hint is int:
        yield from wrong(Reason.FIELD_TYPE, 1.0, math.nan, "1", "", [1], {})
        yield from wrong(Reason.RANGE, -1, -(2**63), 2**63, 2**64 - 1)
    elif hint is float:
        yield from wrong(Reason.FIELD_TYPE, "1.0", "nan", [1.0], {})
        yield from wrong(Reason.NOT_FINITE, *NOT_FINITE)
    elif hint is str:
        yield from wrong(Reason.FIELD_TYPE, 1, 1.0, ["a1"], {"a1": 1})
        yield "ä" * (LONGEST_TEXT.get((kind, name), 40) + 1), Reason.LENGTH
    elif hint is bytes:
        yield from wrong(Reason.FIELD_TYPE, 1, 1.0, "12345678", [1.0], {})
        yield from wrong(Reason.LENGTH, bytes(7), bytes(9))
    elif get_origin(hint) is Literal:
        yield from wrong(Reason.FIELD_TYPE, 1, 1.0, [good], {})
        yield from wrong(Reason.RANGE, "", "sideways", good.upper(), good + " ")
    elif hint == Vector:
        yield from wrong(Reason.FIELD_TYPE, 1, 1.0, "1.0", {})
        yield from vector_misfits(FIXED_LENGTH.get(name))
    else:
        yield from wrong(Reason.FIELD_TYPE, 1, "front", [1.0, 2.0, 3.0])
        yield {"p" * 41: (0.0, 0.0, 0.0)}, Reason.LENGTH
        yield {b"front": (0.0, 0.0, 0.0)}, Reason.FIELD_TYPE
        yield {"front": 1.0}, Reason.FIELD_TYPE
        for point, reason in vector_misfits(3):
            yield {"back": (0.0, 0.0, 0.0), "front": point}, reason


def vector_misfits(length: int | None) -> Iterator[tuple[Any, Reason]]:
    lengths = (0, MAX_JOINTS + 1, 64) if length is None else (0, length - 1, length + 1, MAX_JOINTS)
    yield from wrong(Reason.LENGTH, *([1.0] * k for k in lengths))
    for place in range(length or 7):
        for other in (1.0, 1):  # a whole number sends the check along another path
            vector = [other] * (length or 7)
            for element, reason in (
                *wrong(Reason.NOT_FINITE, *NOT_FINITE),
                *wrong(Reason.FIELD_TYPE, True, "1.0", None, [1.0], b"1"),
            ):
                yield [*vector[:place], element, *vector[place + 1 :]], reason


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, (_, checks) in SCHEMAS.items() for name in checks])
def test_a_misfit_in_any_field_is_refused_with_its_reason(kind: str, name: str) -> None:
    for value, reason in misfits(kind, name, hints(kind)[name]):
        refused = refusal_of(packed(body_of(SAMPLES[kind]) | {name: value}))
        assert (refused.reason, refused.what.split(".")[0]) == (reason, name), value


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, (_, checks) in SCHEMAS.items() for name in checks])
def test_no_field_may_be_missing(kind: str, name: str) -> None:
    body = body_of(SAMPLES[kind])
    del body[name]
    refused = refusal_of(packed(body))
    assert (refused.reason, refused.what) == (Reason.MISSING_FIELD, f"{kind}.{name}")


@every_message
@pytest.mark.parametrize("value", [None, 0, [1.0], {"a": 1}])
def test_no_field_may_be_added(kind: str, value: object) -> None:
    refused = refusal_of(packed(body_of(SAMPLES[kind]) | {"mass": value}))
    assert (refused.reason, refused.what) == (Reason.UNKNOWN_FIELD, f"{kind}.mass")


@every_message
@pytest.mark.parametrize("version", [0, PROTOCOL_VERSION + 1, -1, 1.0, "1", True, None, [1], {"v": 1}, b"\1"], ids=repr)
def test_another_protocol_version_is_refused(kind: str, version: object) -> None:
    body = body_of(SAMPLES[kind])
    assert refusal_of(packed(body | {"v": version})).reason == Reason.VERSION
    del body["v"]
    assert refusal_of(packed(body)).reason == Reason.VERSION


@pytest.mark.parametrize("other", ["", "State", "states", 1, None, True, ["state"], {"state": 1}, b"state"], ids=repr)
def test_an_unknown_type_is_refused(other: object) -> None:
    body = body_of(SAMPLES["state"])
    assert refusal_of(packed(body | {"type": other})).reason == Reason.TYPE
    del body["type"]
    assert refusal_of(packed(body)).reason == Reason.TYPE


@every_message
def test_another_message_than_the_wanted_one_is_refused(kind: str) -> None:
    for other, message in SAMPLES.items():
        if other != kind:
            with pytest.raises(Refused) as refused:
                decode(encode(message), SCHEMAS[kind][0])
            assert (refused.value.reason, refused.value.got, refused.value.expected) == (Reason.TYPE, other, kind)


@every_message
def test_every_true_beginning_of_a_message_and_every_surplus_byte_is_malformed(kind: str) -> None:
    payload = encode(SAMPLES[kind])
    for length in range(len(payload)):
        assert refusal_of(payload[:length]).reason == Reason.MALFORMED
    for surplus in (b"\0", b"\xc0", payload):
        assert refusal_of(payload + surplus).reason == Reason.MALFORMED


NO_MAPS = {
    "nothing": None,
    "number": 1,
    "text": "state",
    "array": [1, "state"],
    "extension": msgpack.ExtType(5, b"x"),
    "timestamp": msgpack.Timestamp(1, 2),
}


@pytest.mark.parametrize("body", NO_MAPS.values(), ids=NO_MAPS)
def test_what_is_no_map_is_malformed(body: object) -> None:
    assert refusal_of(packed(body)).reason == Reason.MALFORMED


BROKEN = {
    "never_used_byte": b"\xc1",
    "text_that_is_not_utf8": b"\x81\xa1v\xa1\xff",
    "surrogate_in_text": b"\x81\xa1v\xa3\xed\xa0\x80",
    "number_as_key": packed({1: 1}),
    "array_as_key": b"\x81\x91\x01\x01",
    "extension_as_key": b"\x81\xd4\x05x\x01",
    "timestamp_with_too_many_nanoseconds": b"\x81\xa1v\xc7\x0c\xff\xff\xff\xff\xff" + b"\0" * 8,
    "timestamp_of_no_known_length": b"\x81\xa1v\xc7\x03\xff\x00\x00\x00",
    "array_that_says_it_has_4_billion_elements": b"\x81\xa1v\xdd\xff\xff\xff\xff",
    "map_that_says_it_has_4_billion_entries": b"\xdf\xff\xff\xff\xff",
    "array_of_65": packed({"v": [0] * 65}),
    "map_of_65": packed({str(k): k for k in range(65)}),
}


@pytest.mark.parametrize("payload", BROKEN.values(), ids=BROKEN)
def test_what_is_no_plain_messagepack_is_malformed(payload: bytes) -> None:
    assert refusal_of(payload).reason == Reason.MALFORMED


def test_a_payload_is_looked_at_up_to_its_longest_length_and_no_further() -> None:
    """A MessagePack text of just the longest length is read, and found to be no map; one byte more is not read."""
    longest = b"\xda" + (MAX_BYTES - 3).to_bytes(2, "big") + b"a" * (MAX_BYTES - 3)
    assert (len(longest), refusal_of(longest).reason) == (MAX_BYTES, Reason.MALFORMED)
    assert refusal_of(b"\xda" + (MAX_BYTES - 2).to_bytes(2, "big") + b"a" * (MAX_BYTES - 2)).reason == Reason.LENGTH
    assert refusal_of(encode(SAMPLES["state"]) + b"\0" * MAX_BYTES).reason == Reason.LENGTH


PLACES = {
    "in place of the map": b"",
    "as version": b"\x82\xa4type\xa3end\xa1v",
    "as type": b"\x82\xa1v\x01\xa4type",
    "as text": b"\x83\xa1v\x01\xa4type\xa3end\xa6reason",
    "as choice": b"\x83\xa1v\x01\xa4type\xa5order\xa4verb",
    "as vector": b"\x86\xa1v\x01\xa4type\xacleader_force\xa4tick\x01\xa5lease\x01\xa5point\xa1p\xa5force",
    "as points": (
        b"\x86\xa1v\x01\xa4type\xa7welcome\xa5lease\x01\xa5clock\xa9lock-step\xb1control_period_ns\x01\xa6points"
    ),
    "as unknown field": b"\x84\xa1v\x01\xa4type\xa3end\xa6reason\xa1x\xa1y",
}


@pytest.mark.parametrize("unit", [b"\x91", b"\x81\xa1k"], ids=["arrays", "maps"])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_deep_nesting_is_refused_and_never_overflows(place: bytes, unit: bytes) -> None:
    """MessagePack reads 1023 levels, more than ``repr`` can print: a refusal must not try to."""
    for depth in (1, 2, 17, 500, 1000, 1021, 1022, 1023, 1024, 2500, 8000):
        assert isinstance(judged(place + unit * depth + b"\x01"), Refused), depth


def test_a_refusal_can_be_sent_back_however_long_the_misfit_is() -> None:
    long = "x" * 7000
    body = body_of(SAMPLES["end"])
    for misfit in ({long: 1}, {"type": long}, {"v": long}, {"reason": long}, {long: 1, "v": long}):
        assert isinstance(judged(packed(body | misfit)), Refused)
    assert isinstance(judged(packed(body_of(SAMPLES["order"]) | {"verb": long})), Refused)
