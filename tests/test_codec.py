"""Messages to bytes and back: what is sent arrives, and what does not fit is refused for the right reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgpack
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from wire import PROTOCOL_VERSION
from wire.codec import MAX_BYTES, SCHEMAS, _decode_the_long_way, decode, decode_any, encode
from wire.errors import Reason, Refused
from wire.messages import (
    MAX_INT,
    MAX_JOINTS,
    Command,
    Deed,
    Done,
    End,
    Goodbye,
    Hello,
    LeaderForce,
    LeaderView,
    Message,
    Order,
    Progress,
    Refusal,
    State,
    Vector,
    Welcome,
)

FIXED_LENGTH = {
    "wrench": 6,
    "base_force": 3,
    "force": 3,
    "position": 3,
    "quat_wxyz": 4,
    "linear_velocity": 3,
    "angular_velocity": 3,
}
"""Vectors that are as long for every arm; all others have one number per joint."""

LONGEST_TEXT = {
    ("hello", "digest"): 64,
    ("hello", "host"): 255,
    ("refusal", "text"): 1000,
    ("end", "reason"): 1000,
    ("progress", "waiting_for"): 400,
    ("done", "problem"): 1000,
}
"""All other texts have at most 40 characters."""

# Every message the peer may send: Hypothesis

finite = st.floats(allow_nan=False, allow_infinity=False)
integers = st.integers(0, MAX_INT)
joints = st.lists(finite, min_size=1, max_size=MAX_JOINTS).map(tuple)


def text(longest: int = 40) -> st.SearchStrategy[str]:
    return st.text(st.characters(codec="utf-8"), max_size=longest)


def vector(length: int) -> st.SearchStrategy[Vector]:
    return st.tuples(*[finite] * length)


MESSAGES: dict[str, st.SearchStrategy[Message]] = {
    "hello": st.builds(
        Hello,
        role=st.sampled_from(["follower", "leader"]),
        run=text(),
        name=text(),
        arm_model=text(),
        digest=text(64),
        pid=integers,
        host=text(255),
    ),
    "welcome": st.builds(
        Welcome,
        lease=integers,
        clock=st.sampled_from(["lock-step", "real-time"]),
        control_period_ns=integers,
        points=st.dictionaries(text(), vector(3), max_size=6),
        force_max_N=finite,
    ),
    "refusal": st.builds(Refusal, reason=text(), text=text(1000)),
    "state": st.builds(
        State, arm=text(), tick=integers, time_ns=integers, q=joints, qd=joints, tau=joints, wrench=vector(6)
    ),
    "command": st.builds(
        Command,
        arm=text(),
        tick=integers,
        lease=integers,
        torque=joints,
        base_force=vector(3),
        stiffness=joints,
        step_ns=integers,
    ),
    "leader_view": st.builds(
        LeaderView,
        tick=integers,
        time_ns=integers,
        position=vector(3),
        quat_wxyz=vector(4),
        linear_velocity=vector(3),
        angular_velocity=vector(3),
    ),
    "leader_force": st.builds(LeaderForce, tick=integers, lease=integers, point=text(), force=vector(3)),
    "goodbye": st.builds(Goodbye, name=text(), lease=integers),
    "end": st.builds(End, kind=st.sampled_from(["over", "lost"]), reason=text(1000)),
    "progress": st.builds(
        Progress,
        phase=st.sampled_from(["waiting", "running", "ended"]),
        waiting_for=text(400),
        tick=integers,
        ticks=integers,
        time_s=finite,
        real_time_factor=finite,
        tilt_deg=finite,
        goal_distance_m=finite,
        missed_ticks=integers,
        age_max_ticks=integers,
    ),
    "order": st.builds(Order, verb=st.just("stop")),
    "deed": st.builds(
        Deed, number=integers, verb=st.sampled_from(["kill", "stop", "continue", "start", "leave"]), agent=text()
    ),
    "done": st.builds(Done, number=integers, problem=text(1000)),
}

# One of each by hand: the start of every example of what is refused

SEVEN = (0.0, -0.25, 0.5, -2.0, 1e-9, 1.5, 87.0)
SAMPLES: dict[str, Message] = {
    "hello": Hello("follower", "transport", "a1", "panda", "0a" * 32, 4711, "bench-7"),
    "welcome": Welcome(2, "lock-step", 1_000_000, {"front": (0.8, 0.0, 0.72), "centre": (0.0, 0.0, 0.4)}, 40.0),
    "refusal": Refusal("taken", "one instance at a time"),
    "state": State("a1", 12, 12_000_000, SEVEN, SEVEN, SEVEN, (1.0, 2.0, -30.5, 0.1, 0.2, 0.3)),
    "command": Command("a1", 12, 2, SEVEN, (4.0, -3.0, 0.5), SEVEN, 210_000),
    "leader_view": LeaderView(20, 20_000_000, (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.2)),
    "leader_force": LeaderForce(20, 1, "front", (40.0, 0.0, 0.0)),
    "goodbye": Goodbye("a1", 2),
    "end": End("over", "the run is over"),
    "progress": Progress("running", "", 100, 30_000, 0.1, 0.9, 1.25, -1.0, 7, 3),
    "order": Order("stop"),
    "deed": Deed(3, "kill", "a2"),
    "done": Done(3, ""),
}
SLOW_MACHINE: Any = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
"""Time is no property that is tested here: a busy machine must not make a test fail."""

every_message = pytest.mark.parametrize("kind", SCHEMAS)


def body_of(message: Message) -> dict[str, Any]:
    """The MessagePack map of a message, built without the codec."""
    (kind,) = [name for name, (cls, _) in SCHEMAS.items() if cls is type(message)]
    return {"v": 1, "type": kind} | {field.name: getattr(message, field.name) for field in fields(message)}


def packed(body: object) -> bytes:
    return msgpack.packb(body)


def refusal_of(payload: bytes) -> Refused:
    """Why the payload is refused; fails if it is not."""
    with pytest.raises(Refused) as refused:
        decode_any(payload)
    return refused.value


def judged(payload: bytes) -> Message | Refused:
    """A valid message or a refusal that can be sent back: nothing else ever comes out, no other exception either."""
    result: Message | Refused
    try:
        result = decode_any(payload)
    except Refused as refused:
        result = refused
    if isinstance(result, Refused):
        sent_back = decode(encode(Refusal(result.reason, str(result))), Refusal)
        assert (Reason(sent_back.reason), sent_back.text) == (result.reason, str(result))
    else:
        assert encode(decode_any(encode(result))) == encode(result)
    return result


# What is sent arrives


def test_every_message_of_the_wire_is_tried_here() -> None:
    assert set(MESSAGES) == set(SAMPLES) == set(SCHEMAS)
    assert {type(message) for message in SAMPLES.values()} == set(get_args(Message))


@every_message
def test_a_schema_has_its_class_s_fields_in_their_order(kind: str) -> None:
    cls, checks = SCHEMAS[kind]
    assert list(checks) == [field.name for field in fields(cls)]


@every_message
@settings(max_examples=40, **SLOW_MACHINE)
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
    yield from wrong(Reason.FIELD_TYPE, None, True, False, b"a1", extension, msgpack.Timestamp(1))
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


# Whatever comes


@every_message
def test_a_flipped_bit_gives_a_message_or_a_refusal(kind: str) -> None:
    payload = encode(SAMPLES[kind])
    for place in range(len(payload)):
        for bit in range(8):
            flipped = bytearray(payload)
            flipped[place] ^= 1 << bit
            judged(bytes(flipped))


@settings(max_examples=300, **SLOW_MACHINE)
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
@settings(max_examples=20, **SLOW_MACHINE)
@given(data=st.data())
def test_any_value_in_any_field_gives_a_message_or_a_refusal(kind: str, data: st.DataObject) -> None:
    body = body_of(SAMPLES[kind])
    for name in data.draw(st.lists(st.sampled_from(sorted(body)), min_size=1, max_size=3)):
        body[name] = data.draw(values)
    judged(packed(body))


@settings(max_examples=100, **SLOW_MACHINE)
@given(values)
def test_any_value_gives_a_refusal_when_it_is_no_message(value: object) -> None:
    assert isinstance(judged(packed(value)), Refused)


EXAMPLES: dict[str, Message] = {
    "state": State("a1", 5, 5_000_000, (0.5,) * 7, (0.25,) * 7, (1.0,) * 7, (2.0,) * 6),
    "command": Command("a1", 5, 1, (0.5,) * 7, (0.25,) * 3, (1.0,) * 7, 100),
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


@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=400)
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
