"""What an intruder does to hear what is not for it: it asks for keys, and comes in by another way or name."""

from __future__ import annotations

import time
from base64 import b64encode
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

import zenoh

from deploy.authority import issue, new_authority
from deploy.chaos.attempt import Attempt, Got
from deploy.chaos.target import LISTEN_S, Target, heard, replies

ALL_OF_WIRE = "palanquin/**"
GOSSIP = {"scouting": {"gossip": {"enabled": True, "autoconnect": {"peer": ["router", "peer"]}}}}
LISTENER = {"listen": {"endpoints": ["tcp/127.0.0.1:0"]}, **GOSSIP}


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


def _admin_space(target: Target) -> Got:
    with target.session() as session:
        own = str(session.info.zid())
        found = [key for key, _ in replies(session, "@/**") if not key.startswith(f"@/{own}/")]
    return Got(bool(found), f"{len(found)} entries of the simulator's tables")


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
        with target.session_as(overlay(target)) as session:
            counts = heard(session, target.keys.arm(target.victim).state)
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


LISTENING: tuple[Attempt, ...] = (
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
)
