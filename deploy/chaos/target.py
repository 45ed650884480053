"""Whom an intruder attacks, and with what: Zenoh's own sessions, since a hostile process would not use our door."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

import zenoh

from wire.codec import encode
from wire.keys import Keys
from wire.messages import Message

LISTEN_S = 0.3
"""How long each attempt waits for what it might hear: hundreds of ticks of a run in lock-step."""
OPEN_TIMEOUT_MS = 2000
CONTROL_S = 2.0
"""How long a session may take to show that it works, before the attempt on it counts as not made."""


class ControlFailedError(Exception):
    """A session could not do what is its own right: what it is denied then proves nothing."""


@dataclass(frozen=True, slots=True)
class Target:
    """A run that goes on, seen by a hostile process beside the healthy follower of one arm.

    The intruder holds that arm's credential as well: it stands for hostile code inside that follower. What it may do to
    its own arm is its right; everything else must be closed.
    """

    endpoint: str
    run: str
    own: str
    others: tuple[str, ...]
    overlay: Mapping[str, Any] = field(default_factory=dict)
    """Zenoh configuration that proves who it is; empty on an open system."""
    private: tuple[Path, ...] = ()
    """Files that it must not read."""
    pids: tuple[int, ...] = ()
    """Processes of others."""

    @property
    def keys(self) -> Keys:
        return Keys(self.run)

    @property
    def victim(self) -> str:
        """The other arm that single attempts are aimed at."""
        return self.others[0]

    @contextmanager
    def session(self, mode: str = "client", **changes: Any) -> Iterator[zenoh.Session]:
        """A session with its credential that has shown that it works; ``changes`` are laid over it.

        A client must open, and hear its own arm's state. Another mode may be turned away, that is what is tried: a
        client must work just before it.

        Raises:
            ControlFailedError: the client did not work.
            zenoh.ZError: the other mode was refused.
        """
        if mode != "client":
            self.control()
            with self.session_as(self.overlay, mode, **changes) as session:
                yield session
            return
        with ExitStack() as stack:
            try:
                session = stack.enter_context(self.session_as(self.overlay, **changes))
            except zenoh.ZError as error:
                raise ControlFailedError(f"its own login failed: {str(error).splitlines()[0][:60]}") from error
            if not hears(session, self.keys.arm(self.own).state):
                raise ControlFailedError(f"its own session heard no state of {self.own} in {CONTROL_S:g} s")
            yield session

    def control(self) -> None:
        """The right credential works now. Raises ``ControlFailedError`` if not."""
        with self.session():
            pass

    @contextmanager
    def session_as(self, overlay: Mapping[str, Any], mode: str = "client", **changes: Any) -> Iterator[zenoh.Session]:
        """The same with another credential, or none."""
        config: dict[str, Any] = {
            "mode": mode,
            "connect": {"endpoints": [self.endpoint], "timeout_ms": OPEN_TIMEOUT_MS, "exit_on_failure": True},
            "listen": {"endpoints": []},
            "scouting": {"multicast": {"enabled": False}},
            "transport": {"shared_memory": {"enabled": False}},  # else the walls keep it from opening at all
        }
        for layer in (overlay, changes):
            config = merged(config, layer)
        zenoh.init_log_from_env_or("off")
        session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
        try:
            yield session
        finally:
            with suppress(zenoh.ZError):
                session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Nested tables, the second laid over the first."""
    both = dict(below)
    for key, value in above.items():
        mine = both.get(key)
        both[key] = merged(mine, value) if isinstance(mine, Mapping) and isinstance(value, Mapping) else value
    return both


def heard(session: zenoh.Session, *expressions: str, seconds: float = LISTEN_S) -> dict[str, int]:
    """How many messages came on which key while these were subscribed to."""
    counts: dict[str, int] = {}

    def count(sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        counts[key] = counts.get(key, 0) + 1

    callback: Callable[..., Any] = zenoh.handlers.Callback(count, indirect=False)
    subscribers = [session.declare_subscriber(expression, callback) for expression in expressions]
    time.sleep(seconds)
    for subscriber in subscribers:
        subscriber.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
    return counts


def hears(session: zenoh.Session, expression: str, patience_s: float = CONTROL_S) -> bool:
    """Whether a message comes on this in time."""
    came = Event()
    callback: Callable[..., Any] = zenoh.handlers.Callback(lambda sample: came.set(), indirect=False)
    subscriber: Any = session.declare_subscriber(expression, callback)
    try:
        return came.wait(patience_s)
    finally:
        subscriber.undeclare()


def replies(session: zenoh.Session, selector: str, payload: bytes | None = None) -> list[tuple[str, bytes]]:
    """Key and bytes of every good reply to a query, of whoever answers."""
    everybody, each_answer = zenoh.QueryTarget.ALL, zenoh.ConsolidationMode.NONE  # else the first answer hides a second
    got = session.get(selector, payload=payload, timeout=1.0, target=everybody, consolidation=each_answer)
    return [(str(each.ok.key_expr), each.ok.payload.to_bytes()) for each in got if each.ok is not None]


def put(session: zenoh.Session, key: str, *payloads: bytes | Message) -> bool:
    """Put in both ways, with a publisher and without; whether the publisher was matched by a subscriber."""
    packed = [payload if isinstance(payload, bytes) else encode(payload) for payload in payloads]
    publisher = session.declare_publisher(key)
    time.sleep(LISTEN_S / 3)
    status: Any = publisher.matching_status
    for payload in packed:
        publisher.put(payload)
        session.put(key, payload)
    time.sleep(LISTEN_S / 3)
    publisher.undeclare()  # type: ignore[no-untyped-call]  # the stub lacks its return type
    return bool(status.matching)
