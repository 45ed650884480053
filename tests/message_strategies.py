"""Messages for tests of the wire: every one that a peer may send, one of each by hand, and how a payload is judged."""

from __future__ import annotations

from typing import Any

import msgpack
import pytest
from hypothesis import strategies as st
from msgspec.structs import fields

from wire.codec import SCHEMAS, decode, decode_any, encode
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
        carry_height_m=finite,
        strut=vector(7),
    ),
    "refusal": st.builds(Refusal, reason=text(), text=text(1000)),
    "state": st.builds(
        State,
        arm=text(),
        tick=integers,
        time_ns=integers,
        q=joints,
        qd=joints,
        tau=joints,
        wrench=vector(6),
        grip_m=finite,
        odometry=vector(6),
    ),
    "command": st.builds(
        Command,
        arm=text(),
        tick=integers,
        lease=integers,
        torque=joints,
        base_force=vector(3),
        grip_m=finite,
        stiffness=joints,
        residual_W=finite,
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
    "leaving": st.builds(Leaving, name=text(), lease=integers),
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
    "row": st.builds(
        Row,
        tick=integers,
        tick_ns=integers,
        arms=text(400),
        struts=text(400),
        values=st.integers(0, 40).flatmap(lambda n: st.binary(min_size=8 * n, max_size=8 * n)),
    ),
    "event": st.builds(Event, tick=integers, time_s=finite, kind=text(), details=text(1000)),
    "order": st.builds(Order, verb=st.sampled_from(["stop", "join"]), strut=integers),
    "deed": st.builds(
        Deed,
        number=integers,
        verb=st.sampled_from(["kill", "stop", "continue", "start", "leave", "hang", "slow", "disconnect", "reconnect"]),
        agent=text(),
    ),
    "done": st.builds(Done, number=integers, problem=text(1000)),
}

# One of each by hand: the start of every example of what is refused

SEVEN = (0.0, -0.25, 0.5, -2.0, 1e-9, 1.5, 87.0)
SAMPLES: dict[str, Message] = {
    "hello": Hello("follower", "transport", "a1", "panda", "0a" * 32, 4711, "bench-7"),
    "welcome": Welcome(
        2, "lock-step", 1_000_000, {"front": (0.8, 0.0, 0.72), "centre": (0.0, 0.0, 0.4)}, 40.0, 0.0, SEVEN
    ),
    "refusal": Refusal("taken", "one instance at a time"),
    "state": State("a1", 12, 12_000_000, SEVEN, SEVEN, SEVEN, (1.0, 2.0, -30.5, 0.1, 0.2, 0.3), 0.03, (0.0,) * 6),
    "command": Command("a1", 12, 2, SEVEN, (4.0, -3.0, 0.5), 0.0, SEVEN, -0.25, 210_000),
    "leader_view": LeaderView(20, 20_000_000, (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.2)),
    "leader_force": LeaderForce(20, 1, "front", (40.0, 0.0, 0.0)),
    "leaving": Leaving("a1", 2),
    "goodbye": Goodbye("a1", 2),
    "end": End("over", "the run is over"),
    "progress": Progress("running", "", 100, 30_000, 0.1, 0.9, 1.25, -1.0, 7, 3),
    "row": Row(100, 870_000, "a1 a2", "1 2", bytes(16)),
    "event": Event(100, 0.1, "lost", '{"agent": "a2"}'),
    "order": Order("stop", 0),
    "deed": Deed(3, "kill", "a2"),
    "done": Done(3, ""),
}

every_message = pytest.mark.parametrize("kind", SCHEMAS)


def body_of(message: Message) -> dict[str, Any]:
    """The MessagePack map of a message, built without the codec."""
    (kind,) = [name for name, (cls, _) in SCHEMAS.items() if cls is type(message)]
    return {"v": 2, "type": kind} | {field.name: getattr(message, field.name) for field in fields(message)}


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
