"""What an intruder says that is not for it to say: as another, on its own key what does not fit, on keys of others."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any, Literal

import zenoh

from deploy.chaos.attempt import Attempt, Got
from deploy.chaos.target import LISTEN_S, Target, put, replies
from wire.arms import arm_digest
from wire.codec import decode_any, encode
from wire.messages import Command, End, Goodbye, Hello, LeaderForce, Refusal, State

SEVEN = (0.0,) * 7
FLOOD_S, FLOOD_PER_S = 1.0, 10_000
WRONG_LEASE = 4_000_000
WRITTEN = "an intruder was here"


def _says(key: Callable[[Target], str], make: Callable[[Target], bytes], count: int = 50) -> Callable[[Target], Got]:
    """Put on somebody else's key to the simulator; the edge tells whether it arrived."""

    def act(target: Target) -> Got:
        with target.session() as session:
            matched = put(session, key(target), *[make(target)] * count)
        return Got(None, f"{2 * count} messages sent, {'' if matched else 'not '}matched", edge=key(target))

    return act


def _says_on_its_own(make: Callable[[Target], bytes], refused: str, count: int = 50) -> Callable[[Target], Got]:
    """Put what does not fit on its own command key, beside the healthy follower's answers."""

    def act(target: Target) -> Got:
        with target.session() as session:
            put(session, target.keys.arm(target.own).command, *[make(target)] * count)
        return Got(None, f"{2 * count} messages sent", refused=refused, sent=2 * count)

    return act


def _tells(make: Callable[[Target], bytes]) -> Callable[[Target], Got]:
    """Put on the victim's state key, as if it were the simulator; the victim's log tells whether it arrived."""

    def act(target: Target) -> Got:
        with target.session() as session:
            matched = put(session, target.keys.arm(target.victim).state, make(target))
        said = "matched" if matched else "not matched"
        return Got(True if matched else None, said, log=target.victim, only_heard=True)

    return act


def _asks(key: Callable[[Target], str], make: Callable[[Target], bytes]) -> Callable[[Target], Got]:
    """Query; open if there is any answer but a refusal on its own key."""

    def act(target: Target) -> Got:
        its = key(target)
        with target.session() as session:
            got = replies(session, its, make(target))
        if not got:
            return Got(False, "no answer")
        message = decode_any(got[0][1])
        text = message.text if isinstance(message, Refusal) else type(message).__name__
        its_own = its == target.keys.arm(target.own).hello
        refused = isinstance(message, Refusal)
        return Got(not (refused and its_own), f"answer: {text}", only_heard=refused and not its_own)

    return act


def command(arm: str, *, tick: int, lease: int) -> bytes:
    return encode(Command(arm, tick, lease, SEVEN, (0.0, 0.0, 0.0), 0.0, SEVEN, 0.0, 0))


def hello(target: Target, name: str, role: Literal["follower", "leader"] = "follower") -> bytes:
    model, digest = ("panda", arm_digest("panda")) if role == "follower" else ("", "")
    return encode(Hello(role, target.run, name, model, digest, 1, "intruder"))


def _forge_alive(target: Target) -> Got:
    key = target.keys.arm(target.victim).alive
    with target.session() as session:
        token: Any = session.liveliness().declare_token(key)
        time.sleep(LISTEN_S)
        token.undeclare()
        time.sleep(LISTEN_S)
    return Got(None, "token declared and dropped", edge=key)


def _write_config(target: Target) -> Got:
    """Open only if what was written is read back: that the settings can be read is another row."""
    with target.session() as session:
        (zid, *_) = [str(each) for each in session.info.peers_zid()] + [str(z) for z in session.info.routers_zid()]
        for place in (f"@/{zid}/peer/config/metadata", f"@/{zid}/router/config/metadata"):
            session.put(place, json.dumps({"name": WRITTEN}))
        time.sleep(LISTEN_S)
        found = [key for key, value in replies(session, f"@/{zid}/**") if WRITTEN.encode() in value]
    return Got(bool(found), f"what it wrote was read back from {len(found)} keys")


def _answer_for_the_simulator(target: Target) -> Got:
    """Asks itself, over a second session, as a follower would: does the false answer come?"""
    key = target.keys.arm(target.victim).hello
    with target.session() as liar, target.session() as asker:
        callback: Any = zenoh.handlers.Callback(lambda query: query.reply(key, b"lie"), indirect=False)
        queryable: Any = liar.declare_queryable(key, callback)
        time.sleep(LISTEN_S)
        false = [payload for _, payload in replies(asker, key, b"") if payload == b"lie"]
        queryable.undeclare()
    return Got(bool(false), f"{len(false)} false answers came")


def _flood(target: Target) -> Got:
    """As many as are due at each moment. Its reason of refusal is no other row's on this key, so it counts alone."""
    payload, sent = command(target.victim, tick=0, lease=WRONG_LEASE), 0
    with target.session() as session:
        publisher = session.declare_publisher(
            target.keys.arm(target.own).command, congestion_control=zenoh.CongestionControl.DROP
        )
        begin = time.monotonic()
        while sent < FLOOD_S * FLOOD_PER_S:
            due = min(1 + int((time.monotonic() - begin) * FLOOD_PER_S), int(FLOOD_S * FLOOD_PER_S))
            for _ in range(due - sent):
                publisher.put(payload)
            sent = due
            time.sleep(0.001)
        took = time.monotonic() - begin
        time.sleep(LISTEN_S)
    return Got(None, f"{sent} messages in {took:.2f} s, {sent / took:.0f}/s", refused="arm", sent=sent)


def _victims_command(target: Target) -> str:
    return target.keys.arm(target.victim).command


def _own_hello(target: Target) -> str:
    return target.keys.arm(target.own).hello


def _victims_hello(target: Target) -> str:
    return target.keys.arm(target.victim).hello


SPEAKING: tuple[Attempt, ...] = (
    Attempt("write the simulator's settings", "pose", _write_config),
    Attempt("greet as another on its key", "pose", _asks(_victims_hello, lambda t: hello(t, t.victim))),
    Attempt("greet as another on one's own key", "pose", _asks(_own_hello, lambda t: hello(t, t.victim))),
    Attempt("greet as the leader on one's own key", "pose", _asks(_own_hello, lambda t: hello(t, t.own, "leader"))),
    Attempt("greet a second time", "pose", _asks(_own_hello, lambda t: hello(t, t.own))),
    Attempt("answer greetings for the simulator", "pose", _answer_for_the_simulator),
    Attempt("say goodbye with a wrong lease", "pose", _asks(_own_hello, lambda t: encode(Goodbye(t.own, WRONG_LEASE)))),
    Attempt(
        "command with a stale lease", "disturb", _says_on_its_own(lambda t: command(t.own, tick=1, lease=0), "lease")
    ),
    Attempt("replay an old command", "disturb", _says_on_its_own(lambda t: command(t.own, tick=0, lease=1), "stale")),
    Attempt(
        "command a tick to come", "disturb", _says_on_its_own(lambda t: command(t.own, tick=10**9, lease=1), "future")
    ),
    Attempt("send what is no message", "disturb", _says_on_its_own(lambda t: b"\xc1" * 100, "malformed")),
    Attempt("send what is too long", "disturb", _says_on_its_own(lambda t: bytes(1_000_000), "length", count=5)),
    Attempt("flood", "disturb", _flood),
    Attempt("command another arm", "speak", _says(_victims_command, lambda t: command(t.victim, tick=0, lease=1))),
    Attempt(
        "pull as the leader",
        "speak",
        _says(lambda t: t.keys.leader.command, lambda t: encode(LeaderForce(0, 1, "front", (40.0, 0.0, 0.0)))),
    ),
    Attempt("order as the operator", "speak", _says(lambda t: t.keys.order, lambda t: b"\xc1")),
    Attempt(
        "tell another a false state",
        "speak",
        _tells(lambda t: encode(State(t.own, 0, 0, SEVEN, SEVEN, SEVEN, SEVEN[:6], 0.0, SEVEN[:6]))),
    ),
    Attempt("tell another that all is over", "speak", _tells(lambda t: encode(End("sleep", "")))),  # type: ignore[arg-type]
    Attempt("say goodbye for another", "pose", _asks(_victims_hello, lambda t: encode(Goodbye(t.victim, WRONG_LEASE)))),
    Attempt("forge another's sign of life", "pose", _forge_alive),
)
"""In this order: what could end a run comes last, so that an open simulator stands until then. A false end and a false
order are of a kind that is refused where it arrives: that it arrives is the finding."""
