"""Addresses such as ``tcp/127.0.0.1:7447``: what is wrong with one, whether it leaves this machine, who is there."""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass

from wire.errors import LinkError

PROTOCOLS = ("tcp", "tls")
"""No other one: who may listen where, and what the kernel counted, is known for these two only."""
_HOST = re.compile(r"\[[0-9A-Fa-f:.]+(%\w+)?\]|[^\s\[\]:/#?;*@]+")
"""An IPv6 address in brackets, or a name or IPv4 address without anything that Zenoh reads as more than a host."""


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
        """Whether a TCP connection is taken there."""
        try:
            socket.create_connection((self.host, self.port), timeout=1.0).close()
        except (OSError, UnicodeError):
            return False
        return True

    def check_can_listen(self) -> None:
        """Raises :class:`LinkError` if the host is unknown, or the port in use or not ours."""
        try:
            found = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        except (socket.gaierror, UnicodeError) as error:  # the second for a host name that cannot be one
            raise LinkError(
                f"bad address {self.text!r}: host {self.host!r} is unknown ({error}); give one that is", exit_status=2
            ) from error
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
    """Protocol, host and port of an address. Raises :class:`LinkError` if it is not one over TCP."""
    protocol, _, address = text.partition("/")
    host, _, port = address.rpartition(":")
    number = int(port) if port.isascii() and port.isdigit() and len(port) <= 5 else 0
    if protocol not in PROTOCOLS or not _HOST.fullmatch(host) or not 0 < number <= 65535:
        raise LinkError(
            f"bad address {text!r}: expected tcp/<host>:<port> or tls/<host>:<port>, for example tcp/127.0.0.1:7447 "
            "or tls/[::1]:7447",
            exit_status=2,
        )
    return Endpoint(text, protocol, host.strip("[]"), number)


def check_stays_here_or_is_proven(
    endpoint: Endpoint, *, has_credentials: bool, insecure_network: bool | None = None
) -> None:
    """Raises :class:`LinkError` for a listener that others could use and that does not ask for certificates.

    Args:
        insecure_network: whether the user wants that; None where it cannot be wanted.
    """
    if insecure_network or endpoint.stays_here():
        return
    if endpoint.protocol == "tls" and has_credentials:
        return
    if endpoint.protocol == "tls":
        instead = "give credentials, which hold them (docs/credentials.md)"
    else:
        instead = f"listen on tls/{endpoint.text.partition('/')[2]} with credentials (docs/credentials.md)"
    insecure = "" if insecure_network is None else ", or say --insecure-network"
    raise LinkError(
        f"will not listen on {endpoint.text}: other machines can reach it, and only certificates keep them out; "
        f"{instead}{insecure}",
        exit_status=2,
    )
