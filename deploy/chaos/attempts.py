"""What an intruder tries on the wire, one row each. Every attempt returns what it got; the same rows are run against an
open simulator, so that "what an open system gives" is measured and not asserted.

Some effects are seen elsewhere: at the simulator's edge (counts of a key in ``audit.json``), or in another follower's
log. Such an attempt names the place, and deploy/chaos/evidence.py looks there after the run.
"""

from __future__ import annotations

import time
from base64 import b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

import zenoh

from deploy.authority import issue, new_authority
from deploy.chaos.target import LISTEN_S, Target, heard, put, replies
from wire.arms import arm_digest
from wire.codec import decode_any, encode
from wire.messages import Command, End, Goodbye, Hello, LeaderForce, Refusal, State

SEVEN = (0.0,) * 7
FLOOD_S, FLOOD_PER_S = 1.0, 10_000
WRONG_LEASE = 4_000_000
ALL_OF_WIRE = "palanquin/**"


@dataclass(frozen=True, slots=True)
class Got:
    """What an attempt gave.

    Attributes:
        is_open: whether it gave what it must not; None: ``elsewhere`` decides.
        evidence: what was seen, in words.
        edge: a key whose count at the simulator's edge tells.
        log: an arm whose follower's log tells.
        refused: the attempt is about its own key: it is closed if the simulator refused it for this reason.
        tested: whether the intruder's own session worked; if not, the row is neither open nor closed.
    """

    is_open: bool | None
    evidence: str
    edge: str = ""
    log: str = ""
    refused: str = ""
    tested: bool = True
    only_heard: bool = False
    """It is open in that it was heard where it must not be, but it was refused there and changed nothing."""
    sent: int = 0
    """How many messages of its own it sent; a count of refusals beyond that is another attempt's."""


Way = Literal["hear", "speak", "pose", "disturb", "connect", "host"]


@dataclass(frozen=True, slots=True)
class Attempt:
    """One row: what is tried."""

    name: str
    way: Way
    act: Callable[[Target], Got]


def _hears(*expressions: str, mode: str = "client", **changes: Any) -> Callable[[Target], Got]:
    """Listen; open if anything but what is its own comes. ``{run}``, ``{victim}`` are filled in."""

    def act(target: Target) -> Got:
        asked = [each.format(run=target.keys.root, victim=target.victim) for each in expressions]
        with target.session(mode, **changes) as session:
            counts = heard(session, *asked)
        for its_own in (target.keys.arm(target.own).state, target.keys.arm(target.own).command):
            counts.pop(its_own, None)
        text = ", ".join(f"{count} on {key}" for key, count in sorted(counts.items())) or "nothing"
        return Got(bool(counts), f"heard {text}")

    return act


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
    return encode(Command(arm, tick, lease, SEVEN, (0.0, 0.0, 0.0), SEVEN, 0))


def hello(target: Target, name: str, role: Literal["follower", "leader"] = "follower") -> bytes:
    model, digest = ("panda", arm_digest("panda")) if role == "follower" else ("", "")
    return encode(Hello(role, target.run, name, model, digest, 1, "intruder"))


def _alive_of_others(target: Target) -> Got:
    with target.session() as session:
        tokens = [str(each.ok.key_expr) for each in session.liveliness().get(ALL_OF_WIRE, timeout=1.0) if each.ok]
    allowed = {target.keys.arm(target.own).alive, target.keys.sim_alive}
    others = [key for key in tokens if key not in allowed]
    return Got(bool(others), f"sees {', '.join(sorted(others)) or 'nobody'}")


def _watch_others(target: Target) -> Got:
    seen: list[str] = []
    with target.session() as session:
        callback: Any = zenoh.handlers.Callback(lambda sample: seen.append(str(sample.key_expr)), indirect=False)
        watched = target.keys.arm(target.victim).alive
        watcher: Any = session.liveliness().declare_subscriber(watched, callback, history=True)
        time.sleep(LISTEN_S)
        watcher.undeclare()
    return Got(bool(seen), f"told of {len(seen)} signs of life")


def _forge_alive(target: Target) -> Got:
    key = target.keys.arm(target.victim).alive
    with target.session() as session:
        token: Any = session.liveliness().declare_token(key)
        time.sleep(LISTEN_S)
        token.undeclare()
        time.sleep(LISTEN_S)
    return Got(None, "token declared and dropped", edge=key)


def _admin_space(target: Target) -> Got:
    with target.session() as session:
        own = str(session.info.zid())
        found = [key for key, _ in replies(session, "@/**") if not key.startswith(f"@/{own}/")]
    return Got(bool(found), f"{len(found)} entries of the simulator's tables")


def _write_config(target: Target) -> Got:
    with target.session() as session:
        (zid, *_) = [str(each) for each in session.info.peers_zid()] + [str(z) for z in session.info.routers_zid()]
        session.put(f"@/{zid}/peer/config/adminspace/permissions/write", "true")
        time.sleep(LISTEN_S)
        found = replies(session, f"@/{zid}/peer/config/**")
    return Got(bool(found), f"{len(found)} settings read back")


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


def _whisper(target: Target) -> Got:
    """A key that nobody has planned, between two sessions of the same credential."""
    key = f"{target.keys.root}/whisper"
    with target.session() as one, target.session() as two:
        publisher = two.declare_publisher(key)
        stop = time.monotonic() + LISTEN_S
        got: list[int] = []
        callback: Any = zenoh.handlers.Callback(lambda sample: got.append(1), indirect=False)
        subscriber: Any = one.declare_subscriber(key, callback)
        while time.monotonic() < stop:
            publisher.put(b"psst")
            time.sleep(0.02)
        subscriber.undeclare()
    return Got(bool(got), f"{len(got)} messages came")


def _log_in(overlay: Callable[[Target], Mapping[str, Any]]) -> Callable[[Target], Got]:
    """Open a session as somebody else, just after one in its own name; open if Zenoh lets it in."""

    def act(target: Target) -> Got:
        target.control()
        try:
            with target.session_as(overlay(target)) as session:
                counts = heard(session, target.keys.arm(target.victim).state)
        except zenoh.ZError as error:
            return Got(False, f"refused: {str(error).splitlines()[0][:60]}")
        return Got(True, f"let in, heard {sum(counts.values())} messages")

    return act


def _as_the_victim(target: Target) -> Mapping[str, Any]:
    """With a guessed password, or with a certificate in the victim's name that an authority of our own has signed."""
    tls = target.overlay.get("transport", {}).get("link", {}).get("tls")
    if tls is None:
        return {"transport": {"auth": {"usrpwd": {"user": target.victim, "password": "guessed"}}}}
    now = datetime.now(UTC)
    forged = issue(*new_authority(now), target.victim, now, now + timedelta(days=1))
    mine = {"connect_certificate_base64": forged.certificate, "connect_private_key_base64": forged.key}
    forgery = {name: b64encode(text.encode()).decode() for name, text in mine.items()}
    return {"transport": {"link": {"tls": {**tls, **forgery}}}}


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


def _meets_others(mode: str, **changes: Any) -> Callable[[Target], Got]:
    """Gossip, or a listener of its own: open if any session but the simulator's turns up."""

    def act(target: Target) -> Got:
        with target.session(mode, **changes) as session:
            time.sleep(2 * LISTEN_S)
            known = {str(zid) for zid in [*session.info.peers_zid(), *session.info.routers_zid()]}
        return Got(len(known) > 1, f"linked to {len(known)} sessions (the simulator is one)")

    return act


def _scout(target: Target) -> Got:
    found: Any = zenoh.scout(what="peer|router|client")
    time.sleep(LISTEN_S)
    hellos = []
    while (each := found.try_recv()) is not None:
        hellos.append(each)
    found.stop()
    return Got(bool(hellos), f"{len(hellos)} answers to a call on the network")


def _victims_command(target: Target) -> str:
    return target.keys.arm(target.victim).command


def _own_hello(target: Target) -> str:
    return target.keys.arm(target.own).hello


def _victims_hello(target: Target) -> str:
    return target.keys.arm(target.victim).hello


GOSSIP = {"scouting": {"gossip": {"enabled": True, "autoconnect": {"peer": ["router", "peer"]}}}}
LISTENER = {"listen": {"endpoints": ["tcp/127.0.0.1:0"]}, **GOSSIP}

ON_THE_WIRE: tuple[Attempt, ...] = (
    Attempt("hear everything", "hear", _hears("**")),
    Attempt("hear all of Palanquin", "hear", _hears(ALL_OF_WIRE)),
    Attempt("hear the whole run", "hear", _hears("{run}/**")),
    Attempt("hear another arm's state", "hear", _hears("{run}/arm/{victim}/state")),
    Attempt("hear all arms' states", "hear", _hears("{run}/arm/*/state")),
    Attempt("hear another arm's commands", "hear", _hears("{run}/arm/{victim}/command")),
    Attempt("hear the leader's view of the load", "hear", _hears("{run}/leader/view")),
    Attempt("hear the leader's force", "hear", _hears("{run}/leader/force")),
    Attempt("hear the truth", "hear", _hears("{run}/truth/**")),
    Attempt("ask who is alive", "hear", _alive_of_others),
    Attempt("watch whether another lives", "hear", _watch_others),
    Attempt("read the simulator's tables", "hear", _admin_space),
    Attempt("whisper on a key of one's own", "hear", _whisper),
    Attempt("hear as a peer", "connect", _hears("{run}/arm/{victim}/state", mode="peer")),
    Attempt("hear as a router", "connect", _hears("{run}/arm/{victim}/state", mode="router")),
    Attempt("gossip as a peer", "connect", _meets_others("peer", **GOSSIP)),
    Attempt("gossip as a router", "connect", _meets_others("router", **GOSSIP)),
    Attempt("listen for others", "connect", _meets_others("peer", **LISTENER)),
    Attempt("call for others on the network", "connect", _scout),
    Attempt("log in without a credential", "connect", _log_in(lambda target: {})),
    Attempt("log in as another", "connect", _log_in(_as_the_victim)),
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
        _tells(lambda t: encode(State(t.own, 0, 0, SEVEN, SEVEN, SEVEN, SEVEN[:6]))),
    ),
    Attempt("tell another that all is over", "speak", _tells(lambda t: encode(End("sleep", "")))),  # type: ignore[arg-type]
    Attempt("say goodbye for another", "pose", _asks(_victims_hello, lambda t: encode(Goodbye(t.victim, WRONG_LEASE)))),
    Attempt("forge another's sign of life", "pose", _forge_alive),
)
"""In this order: what could end a run comes last, so that an open simulator stands until then. A false end and a false
order are of a kind that is refused where it arrives: that it arrives is the finding."""
