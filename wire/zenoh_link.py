"""The one door to Zenoh: sessions whose configuration keeps agents apart, behind the interface of wire/link.py.

The simulator is a peer that listens and neither gossips nor scouts; an agent is a client with one connection and no
listener. Why each setting: docs/wire.md, section "Transport".
"""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Self, cast

import zenoh

from wire.errors import LinkError
from wire.link import Census, Declared, Kind

CENSUS_S = 2.0
"""How long to wait for what our own session knows; it takes less than a millisecond."""

_COMMON: dict[str, Any] = {
    "scouting": {"multicast": {"enabled": False, "autoconnect": []}, "gossip": {"enabled": False}},
    "timestamping": {"enabled": False},
    "adminspace": {"enabled": False},
    "transport": {
        "unicast": {"qos": {"enabled": False}, "lowlatency": False, "open_timeout": 2000, "accept_timeout": 2000},
        "link": {
            "tx": {
                "lease": 500,
                "keep_alive": 4,
                "queue": {
                    "congestion_control": {"drop": {"wait_before_drop": 1000}, "block": {"wait_before_close": 50000}}
                },
            }
        },
        "shared_memory": {"enabled": False},
    },
}


_OWN_EYES: dict[str, Any] = {
    "adminspace": {"enabled": True, "permissions": {"read": True, "write": False}},
    "access_control": {
        "enabled": True,
        "default_permission": "allow",
        "rules": [
            {
                "id": "admin",
                "permission": "deny",
                "messages": ["put", "delete", "declare_subscriber", "query", "reply", "declare_queryable"],
                "flows": ["ingress", "egress"],
                "key_exprs": ["@/**"],
            }
        ],
        "subjects": [{"id": "everybody"}],
        "policies": [{"rules": ["admin"], "subjects": ["everybody"]}],
    },
}
"""The simulator's session can read its own routing tables, which is what the audit rests on; nobody else can."""


def free_endpoint() -> str:
    """An address on this machine that nobody listens on just now, as a Zenoh endpoint."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def open_server(endpoint: str) -> ZenohLink:
    """The simulator's session, listening on ``endpoint`` (for example ``tcp/127.0.0.1:7447``).

    Raises:
        LinkError: the address is bad or in use.
    """
    _check_can_listen(endpoint)
    return _open(
        {**_COMMON, **_OWN_EYES, "mode": "peer", "listen": {"endpoints": [endpoint]}, "connect": {"endpoints": []}},
        endpoint,
    )


def open_client(endpoint: str, *, timeout_s: float = 10.0) -> ZenohLink:
    """An agent's session: one connection to ``endpoint``, no listener. It reconnects by itself.

    Raises:
        LinkError: the address is bad, or nobody answered there within ``timeout_s``.
    """
    _parse(endpoint)
    connect = {
        "endpoints": [endpoint],
        "timeout_ms": int(timeout_s * 1000),
        "exit_on_failure": True,
        "retry": {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 2},
    }
    return _open({**_COMMON, "mode": "client", "listen": {"endpoints": []}, "connect": connect}, endpoint)


def _open(config: dict[str, Any], endpoint: str) -> ZenohLink:
    zenoh.init_log_from_env_or("off")
    try:
        return ZenohLink(zenoh.open(zenoh.Config.from_json5(json.dumps(config))))
    except zenoh.ZError as error:
        if config["mode"] == "client":
            raise LinkError(
                f"nobody answers at {endpoint}: expected a running simulator; start it with `palanquin sim` or give "
                "its address with --connect"
            ) from error
        raise LinkError(f"cannot listen on {endpoint}: {str(error).splitlines()[0]}") from error


def _parse(endpoint: str) -> tuple[str, str, int]:
    """Protocol, host and port of an endpoint. Raises :class:`LinkError` if it does not look like one."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if not (protocol and host and port.isascii() and port.isdigit() and 0 < int(port) <= 65535):
        raise LinkError(f"bad address {endpoint!r}: expected <protocol>/<host>:<port>, for example tcp/127.0.0.1:7447")
    return protocol, host.strip("[]"), int(port)


def port_of(endpoint: str) -> int:
    """The port in an endpoint. Raises :class:`LinkError` if it does not look like one."""
    return _parse(endpoint)[2]


def _check_can_listen(endpoint: str) -> None:
    """Say in one sentence what Zenoh would say in many. Only tcp endpoints are looked at."""
    protocol, host, port = _parse(endpoint)
    if protocol != "tcp":
        return
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (socket.gaierror, UnicodeError) as error:  # the second for a host name that cannot be one
        raise LinkError(f"bad address {endpoint!r}: host {host!r} is unknown ({error})") from error
    family, kind, number, _, where = found[0]
    with socket.socket(family, kind, number) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(where)
        except OSError as error:
            raise LinkError(
                f"cannot listen on {endpoint}: port {port} is in use or not ours ({error.strerror}); stop the other "
                "program or choose another port with --listen"
            ) from error


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
