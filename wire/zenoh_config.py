"""Zenoh's configuration of each kind of session, as plain data. Why each setting: docs/wire.md, section "Transport"."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from copy import deepcopy
from datetime import UTC, datetime
from typing import Any

from wire.access import Subject, access_control
from wire.codec import MAX_BYTES
from wire.credentials import Certificate, Credential, Guests
from wire.errors import CredentialError

Config = dict[str, Any]

ONE_THREAD = (
    "(rx: (handover: app), tx: (handover: app), net: (handover: app), acc: (handover: app), app: (worker_threads: 1))"
)
"""Zenoh's own work on one thread instead of five: a message then costs half the thread switches."""

COMMON: Mapping[str, Any] = {
    "scouting": {"multicast": {"enabled": False, "autoconnect": []}, "gossip": {"enabled": False}},
    "timestamping": {"enabled": False},
    "adminspace": {"enabled": False},
    "transport": {
        "unicast": {"qos": {"enabled": False}, "lowlatency": False, "open_timeout": 5000, "accept_timeout": 5000},
        "link": {
            "tx": {
                "lease": 10_000,
                "keep_alive": 4,
                "queue": {
                    "size": {"data": 16},
                    "congestion_control": {"drop": {"wait_before_drop": 1000}, "block": {"wait_before_close": 50000}},
                },
            }
        },
        "shared_memory": {"enabled": False},
    },
}
SIZE_LIMIT: Mapping[str, Any] = {
    "id": "longest-message",
    "flows": ["ingress"],
    "messages": ["put", "delete", "query", "reply"],
    "key_exprs": ["**"],
    "size_limit": MAX_BYTES,
}
"""What is longer than any message may be goes no further than the edge: not even the simulator's decoder sees it."""


ALL_ARE_GUESTS: Mapping[str, Any] = {"south": [{"filters": [{"modes": ["client", "peer", "router"]}]}]}
"""Whoever connects hangs below us, in whatever mode. A session in mode peer would be an equal, and be told the name of
every key that anybody declared: who else there is. The access rules do not see that kind of message. With this, Zenoh
tells a peer no more than a client, and turns a router away at the door."""

OWN_EYES: Mapping[str, Any] = {
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


def uses_certificates(endpoint: str) -> bool:
    """Whether a link to this address proves who is there with certificates. On others it is a password."""
    return endpoint.partition("/")[0] == "tls"


def open_server_config(endpoint: str) -> Config:
    """A simulator that lets everybody in: for one's own machine, and tests."""
    common = deepcopy({**COMMON, **OWN_EYES})
    return {**common, "mode": "peer", "listen": {"endpoints": [endpoint]}, "connect": {"endpoints": []}}


def server_config(endpoint: str, guests: Guests, run: str, passwords_file: str) -> Config:
    """A listening session, simulator or router, that lets the guests in and denies what the table does not allow.

    Mode peer, for the router too: it forwards between its clients in the same way, and link-state messages, which
    tell one router the name that another chose for itself, are sent by mode router only.

    Args:
        passwords_file: where Zenoh finds the guests' passwords when it opens.

    Raises:
        CredentialError: a ``tls/`` address, and a credential without certificate.
    """
    config = open_server_config(endpoint)
    by: tuple[Subject, ...] = ("usernames", "cert_common_names") if uses_certificates(endpoint) else ("usernames",)
    principals = [guest.who for guest in guests.in_time(datetime.now(UTC))]
    config["access_control"] = access_control(run, principals, by)
    config["low_pass_filter"] = [dict(SIZE_LIMIT)]
    config["gateway"] = deepcopy(dict(ALL_ARE_GUESTS))
    transport = config["transport"]
    if uses_certificates(endpoint):
        certificate = _certificate_of(guests.own)
        transport["link"]["tls"] = {
            "root_ca_certificate_base64": _base64(certificate.authority),
            "listen_certificate_base64": _base64(certificate.certificate),
            "listen_private_key_base64": _base64(certificate.key),
            "enable_mtls": True,
            "close_link_on_expiration": True,
        }
    # With certificates too: Zenoh knows no revocation, and a certificate that was replaced still has our signature. Not
    # the simulator's own login: with that it would let in whoever knows it.
    transport["auth"] = {"usrpwd": {"dictionary_file": passwords_file}}
    return config


def client_config(endpoint: str, credential: Credential | None) -> Config:
    """An agent's session: one connection, no listener, one try at the opening (who wants more tries again).

    Raises:
        CredentialError: a ``tls/`` address, and no certificate.
    """
    connect = {
        "endpoints": [endpoint],
        "timeout_ms": 0,
        "exit_on_failure": True,
        "retry": {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 2},
    }
    config = {**deepcopy(dict(COMMON)), "mode": "client", "listen": {"endpoints": []}, "connect": connect}
    if uses_certificates(endpoint):
        certificate = _certificate_of(credential)
        config["transport"]["link"]["tls"] = {
            "root_ca_certificate_base64": _base64(certificate.authority),
            "connect_certificate_base64": _base64(certificate.certificate),
            "connect_private_key_base64": _base64(certificate.key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
    if credential is not None:
        config["transport"]["auth"] = {"usrpwd": {"user": credential.who.login, "password": credential.password}}
    return config


def passwords(guests: Guests) -> str:
    """The guests' logins and passwords as Zenoh reads them, one a line."""
    return "".join(f"{guest.who.login}:{guest.password}\n" for guest in guests.in_time(datetime.now(UTC)))


def _certificate_of(credential: Credential | None) -> Certificate:
    if credential is None or credential.certificate is None:
        raise CredentialError(
            "a tls/ address needs a certificate: make credentials with `palanquin credentials DIR` and give this "
            "process its folder with --credential"
        )
    return credential.certificate


def _base64(text: str) -> str:
    return b64encode(text.encode()).decode()
