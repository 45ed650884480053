"""The one door to Zenoh: sessions whose configuration keeps agents apart, behind the interface of wire/link.py.

The simulator is a peer that listens and neither gossips nor scouts; an agent is a client with one connection and no
listener. What each is told: wire/zenoh_config.py.
"""

from __future__ import annotations

import ctypes
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

import zenoh

from wire.credentials import Credential, Guests
from wire.endpoints import check_stays_here_or_is_proven, parse_endpoint
from wire.errors import CredentialError, LinkError, LoginRefused
from wire.link import Census, Declared, Kind
from wire.private_files import read_private
from wire.router_config import check_router_config
from wire.zenoh_config import ONE_THREAD, client_config, open_server_config, passwords, server_config, uses_certificates

# Zenoh reads it once, when the first session of a process opens. A user's own setting stays.
os.environ.setdefault("ZENOH_RUNTIME", ONE_THREAD)

CENSUS_S = 1.0
"""How long to wait for what our own session knows; it takes a few milliseconds, or never comes back."""

REFUSALS_ARE_NO_ACCIDENT = 3
"""Openings in a row that somebody who listens there ended at once: a login that is refused, not one lost in a rush."""
AT_ONCE_S = 1.0
RETRY_S = 0.05
MOST_PASSWORDS_BYTES = 60_000
"""What a pipe takes without a reader."""


_thread = threading.local()


def _make_known() -> None:
    """Have Python remember this thread of Zenoh's. It would otherwise make a new state for it at every call and throw
    it away after: a quarter of the cost of a message. Never released, since the thread lives as long as the session."""
    ctypes.pythonapi.PyGILState_Ensure()
    _thread.known = True


def free_endpoint() -> str:
    """An address on this machine that nobody listens on just now, as a Zenoh endpoint."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def open_server(
    endpoint: str, guests: Guests | None = None, run: str = "", *, insecure_network: bool = False
) -> ZenohLink:
    """The simulator's session, listening on ``endpoint`` (for example ``tcp/127.0.0.1:7447``).

    Args:
        guests: whom to let in, each to its own keys of ``run``; without, everybody may hear and command everything.
        insecure_network: listen where other machines can reach it, without certificates.

    Raises:
        LinkError: the address is bad, in use, or open to other machines without certificates.
        CredentialError: a ``tls/`` address, and no certificate.
    """
    address = parse_endpoint(endpoint)
    address.check_can_listen()
    check_stays_here_or_is_proven(address, has_credentials=guests is not None, insecure_network=insecure_network)
    if guests is None:
        if uses_certificates(endpoint):
            raise CredentialError(f"{endpoint}: a tls/ address needs a certificate: give the simulator's credentials")
        return _open(open_server_config(endpoint), endpoint)
    with _readable_once(passwords(guests)) as file:
        return _open(server_config(endpoint, guests, run, file), endpoint)


def open_router(config_file: Path) -> ZenohLink:
    """A session that stands between simulator and agents, as ``palanquin credentials --router-config`` describes it.

    Raises:
        LinkError: the file is not such a configuration, or its address is bad, in use, or open to other machines.
        CredentialError: others may read the file, or the one with the passwords that it names.
    """
    text = read_private(config_file, "the configuration of a router")
    try:
        address = check_router_config(zenoh.Config.from_json5(text).get_json)
    except (zenoh.ZError, ValueError) as error:
        what = "not JSON5, or not Zenoh's" if isinstance(error, zenoh.ZError) else str(error)
        raise LinkError(
            f"{config_file}: not a router's configuration of ours ({what}); make one with `palanquin credentials DIR "
            "--router-config FILE --run NAME`",
            exit_status=2,
        ) from error
    address.check_can_listen()
    return _open(text, address.text)


def open_client(endpoint: str, credential: Credential | None = None, *, timeout_s: float = 10.0) -> ZenohLink:
    """An agent's session: one connection to ``endpoint``, no listener. It reconnects by itself.

    Raises:
        LinkError: the address is bad, or nobody answered there within ``timeout_s``.
        LoginRefused: somebody did, and refused this credential, or the lack of one.
        CredentialError: a ``tls/`` address, and no certificate.
    """
    address = parse_endpoint(endpoint)
    config = client_config(endpoint, credential)
    deadline = time.monotonic() + timeout_s
    refusals = 0
    while True:
        started = time.monotonic()
        try:
            return _open(config, endpoint)
        except LinkError as error:
            at_once = time.monotonic() - started < AT_ONCE_S
            refusals = refusals + 1 if at_once and address.somebody_listens() else 0
            if refusals >= REFUSALS_ARE_NO_ACCIDENT:
                raise LoginRefused(_refused(endpoint, credential)) from error
            if time.monotonic() > deadline:
                raise
        time.sleep(RETRY_S)


def _refused(endpoint: str, credential: Credential | None) -> str:
    if credential is None:
        return (
            f"who listens at {endpoint} refused this process: it asks for a credential (give its folder with "
            "--credential; `palanquin credentials` makes them), or is no simulator"
        )
    return (
        f"who listens at {endpoint} refused the credential of {credential.who.name}: not made for this simulator, "
        "revoked, replaced or expired there, or the address is not the simulator's"
    )


@contextmanager
def _readable_once(text: str) -> Iterator[str]:
    """The name of a file with this text that never is on a disk: the end of a pipe."""
    content = text.encode()
    if len(content) > MOST_PASSWORDS_BYTES:
        raise CredentialError(f"{len(content)} bytes of passwords, expected at most {MOST_PASSWORDS_BYTES}")
    reading, writing = os.pipe()
    try:
        os.write(writing, content)
        os.close(writing)
        yield f"/dev/fd/{reading}"
    finally:
        os.close(reading)


def _open(config: Mapping[str, Any] | str, endpoint: str) -> ZenohLink:
    zenoh.init_log_from_env_or("off")
    text = config if isinstance(config, str) else json.dumps(config)
    parsed = zenoh.Config.from_json5(text)
    try:
        return ZenohLink(zenoh.open(parsed))
    except zenoh.ZError as error:
        if parsed.get_json("mode") == '"client"':
            raise LinkError(
                f"nobody answers at {endpoint}: expected a running simulator; start it with `palanquin sim` or give "
                "its address with --connect"
            ) from error
        raise LinkError(f"cannot listen on {endpoint}: {str(error).splitlines()[0]}") from error


class ZenohQuestion:
    """A query that waits for its reply."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.key = str(query.key_expr)
        self.payload = query.payload.to_bytes() if query.payload is not None else b""

    def reply(self, payload: bytes) -> None:
        self._query.reply(self.key, payload)
        self._query.drop()  # type: ignore[no-untyped-call]  # the stub lacks its return type


class ZenohPublisher:
    """Sends on one key; drops rather than waits when the reader does not read."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher
        self.put: Callable[[bytes], None] = publisher.put

    def matched(self) -> bool:
        status: Any = self._publisher.matching_status  # the stub says bool; it is an object with this attribute
        return bool(status.matching)


class ZenohLink:
    """One Zenoh session."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._declared: list[Any] = []

    def publisher(self, key: str) -> ZenohPublisher:
        return ZenohPublisher(
            self._session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP, express=True)
        )

    def subscribe(self, key: str, handler: Callable[[bytes], None]) -> None:
        def deliver(sample: zenoh.Sample) -> None:
            if not hasattr(_thread, "known"):
                _make_known()
            handler(sample.payload.to_bytes())

        self._declared.append(self._session.declare_subscriber(key, zenoh.handlers.Callback(deliver, indirect=False)))

    def answer_queries(self, key_expression: str, handler: Callable[[ZenohQuestion], None]) -> None:
        def deliver(query: zenoh.Query) -> None:
            handler(ZenohQuestion(query))

        callback = zenoh.handlers.Callback(deliver, indirect=False)
        self._declared.append(self._session.declare_queryable(key_expression, callback))

    def query(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        for reply in self._session.get(key, payload=payload, timeout=timeout_s):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        return None

    def declare_alive(self, key: str) -> None:
        self._declared.append(self._session.liveliness().declare_token(key))

    def watch_alive(self, key: str, handler: Callable[[bool], None]) -> None:
        def deliver(sample: zenoh.Sample) -> None:
            handler(sample.kind == zenoh.SampleKind.PUT)

        callback = zenoh.handlers.Callback(deliver, indirect=False)
        self._declared.append(self._session.liveliness().declare_subscriber(key, callback, history=True))

    def census(self, keys: Sequence[str]) -> Census | None:
        own = str(self._session.info.zid())
        asked = [(key, zenoh.KeyExpr(key)) for key in keys]
        addresses: dict[str, str] = {}
        declared: list[Declared] = []
        replies = [reply.ok for reply in self._session.get(f"@/{own}/**", timeout=CENSUS_S)]
        for reply in replies:
            chunks = str(reply.key_expr).split("/") if reply is not None else []
            if reply is None or len(chunks) < 5:
                continue
            if chunks[2:5] == ["session", "transport", "unicast"]:
                if len(chunks) > 7:
                    addresses[chunks[5]] = str(json.loads(reply.payload.to_bytes())["dst"])
            elif chunks[3] in ("subscriber", "publisher", "queryable", "token"):
                expression = zenoh.KeyExpr("/".join(chunks[4:]))
                reached = tuple(key for key, exact in asked if expression.intersects(exact))
                sources: dict[str, list[str]] = json.loads(reply.payload.to_bytes())
                declared += [
                    Declared(session, cast(Kind, chunks[3]), str(expression), reached)
                    for session in sorted({zid for zids in sources.values() for zid in zids} - {own})
                ]
        return Census(addresses, tuple(declared)) if replies else None

    def close(self) -> None:
        for declared in self._declared:
            declared.undeclare()
        self._declared.clear()
        self._session.close()  # type: ignore[no-untyped-call]  # the stub lacks its return type

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
