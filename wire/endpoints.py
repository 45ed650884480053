"""Addresses such as ``tcp/127.0.0.1:7447``: what is wrong with one, whether it leaves this machine, who is there."""

from __future__ import annotations

import ipaddress
import socket
from dataclasses import dataclass

from wire.errors import LinkError

OVER_TCP = ("tcp", "tls")
"""Protocols that are looked at before Zenoh is asked; it would say in many sentences what needs one."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """An address in its parts."""

    text: str
    protocol: str
    host: str
    port: int

    def stays_here(self) -> bool:
        """Whether nothing but this machine can reach it. A host that is not known, or not an IP address, may not."""
        try:
            found = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError):
            return False
        return all(ipaddress.ip_address(str(where[0]).partition("%")[0]).is_loopback for *_, where in found)

    def somebody_listens(self) -> bool:
        """Whether a TCP connection is taken there. False for other protocols: it is not known."""
        if self.protocol not in OVER_TCP:
            return False
        try:
            socket.create_connection((self.host, self.port), timeout=1.0).close()
        except (OSError, UnicodeError):
            return False
        return True

    def check_can_listen(self) -> None:
        """Raises :class:`LinkError` if the host is unknown, or the port in use or not ours."""
        if self.protocol not in OVER_TCP:
            return
        try:
            found = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        except (socket.gaierror, UnicodeError) as error:  # the second for a host name that cannot be one
            raise LinkError(f"bad address {self.text!r}: host {self.host!r} is unknown ({error})") from error
        family, kind, number, _, where = found[0]
        with socket.socket(family, kind, number) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(where)
            except OSError as error:
                raise LinkError(
                    f"cannot listen on {self.text}: port {self.port} is in use or not ours ({error.strerror}); stop "
                    "the other program or choose another port with --listen"
                ) from error


def parse_endpoint(text: str) -> Endpoint:
    """Protocol, host and port of an address. Raises :class:`LinkError` if it does not look like one."""
    protocol, _, address = text.partition("/")
    host, _, port = address.rpartition(":")
    if not (protocol and host and port.isascii() and port.isdigit() and 0 < int(port) <= 65535):
        raise LinkError(f"bad address {text!r}: expected <protocol>/<host>:<port>, for example tcp/127.0.0.1:7447")
    return Endpoint(text, protocol, host.strip("[]"), int(port))


def check_stays_here_or_is_proven(endpoint: Endpoint, *, has_credentials: bool, insecure_network: bool) -> None:
    """Raises :class:`LinkError` for a listener that others could use and that does not ask for certificates."""
    if endpoint.protocol not in OVER_TCP or insecure_network or endpoint.stays_here():
        return
    if endpoint.protocol == "tls" and has_credentials:
        return
    raise LinkError(
        f"will not listen on {endpoint.text}: other machines can reach it, and only certificates keep them out; listen "
        f"on tls/{endpoint.host}:{endpoint.port} with credentials (docs/credentials.md), or say --insecure-network",
        exit_status=2,
    )
