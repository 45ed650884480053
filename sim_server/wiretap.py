"""What the kernel counted on every TCP connection of a listening port: bytes in both directions (Linux).

Evidence that is independent of Zenoh and of our own sending code, as ``ss -tin`` prints it: one netlink dump of
``INET_DIAG``, for which no rights are needed. Other systems have no such thing.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from wire.endpoints import Endpoint

_NETLINK_SOCK_DIAG, _SOCK_DIAG_BY_FAMILY = 4, 20
_NLM_F_REQUEST_DUMP, _NLMSG_ERROR, _NLMSG_DONE = 0x301, 2, 3
_INET_DIAG_INFO = 2
_ALIVE = (1 << 1) | (1 << 4) | (1 << 5) | (1 << 8) | (1 << 9) | (1 << 11)
"""States in which bytes have flowed or may: established, the two of our own closing, the two of theirs, closing."""
_HEADER, _ATTRIBUTE = struct.Struct("=IHHII"), struct.Struct("=HH")
_ADDRESSES = struct.Struct("!HH16s16s4s8s")
_MESSAGE_BYTES = 72
_BYTES_ACKED = 120
"""Where ``tcp_info`` has bytes_acked and, after it, bytes_received (Linux 4.1 and later)."""
_ANSWER_S = 1.0


@dataclass(frozen=True, slots=True)
class Carried:
    """One connection, as the kernel counts it; payload of TCP, what was sent twice counted once."""

    number: int
    """The kernel's own, which no later connection gets again."""
    peer: str
    """Address and port of the other end."""
    sent: int
    """Bytes that the other end has taken."""
    received: int


class Wiretap:
    """The connections of one listening port. What the kernel does not tell is an ``OSError``."""

    def __init__(self, listening: Endpoint) -> None:
        self._port = listening.port
        is_v4 = _is_v4(listening.host)
        self._families = (socket.AF_INET,) if is_v4 else (socket.AF_INET, socket.AF_INET6)

    def connections(self) -> list[Carried]:
        """All that are there now. Raises ``OSError`` where this cannot be asked."""
        if not hasattr(socket, "AF_NETLINK"):
            raise OSError("this system does not tell what a connection carried")
        with socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, _NETLINK_SOCK_DIAG) as kernel:
            kernel.settimeout(_ANSWER_S)
            return [each for family in self._families for each in self._dump(kernel, family)]

    def _dump(self, kernel: socket.socket, family: int) -> Iterator[Carried]:
        asked = struct.pack("=BBBBI", family, socket.IPPROTO_TCP, 1 << (_INET_DIAG_INFO - 1), 0, _ALIVE)
        asked += struct.pack("!HH", self._port, 0) + bytes(44)
        header = _HEADER.pack(_HEADER.size + len(asked), _SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST_DUMP, 1, 0)
        kernel.sendto(header + asked, (0, 0))
        while True:
            answer, at = kernel.recv(1 << 18), 0
            while at < len(answer):
                length, kind, *_ = _HEADER.unpack_from(answer, at)
                body = answer[at + _HEADER.size : at + length]
                if kind == _NLMSG_DONE:
                    return
                if kind == _NLMSG_ERROR:
                    (number,) = struct.unpack_from("=i", body)
                    raise OSError(-number, "the kernel does not tell what a connection carried")
                found = self._read(body, family)
                if found is not None:
                    yield found
                at += (length + 3) & ~3

    def _read(self, body: bytes, family: int) -> Carried | None:
        port, peer_port, _, peer, _, cookie = _ADDRESSES.unpack_from(body, 4)
        at = _MESSAGE_BYTES
        while port == self._port and at + _ATTRIBUTE.size <= len(body):
            length, kind = _ATTRIBUTE.unpack_from(body, at)
            if kind == _INET_DIAG_INFO and length >= _ATTRIBUTE.size + _BYTES_ACKED + 16:
                sent, received = struct.unpack_from("=QQ", body, at + _ATTRIBUTE.size + _BYTES_ACKED)
                where = address(peer[:4] if family == socket.AF_INET else peer, peer_port)
                return Carried(int.from_bytes(cookie, "little"), where, sent, received)
            at += max(_ATTRIBUTE.size, (length + 3) & ~3)
        return None


def _is_v4(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).version == 4
    except ValueError:
        return False


def address(packed: bytes, port: int) -> str:
    """An address as Zenoh writes it after the protocol: ``127.0.0.1:7447`` or ``[::1]:7447``."""
    ip = ipaddress.ip_address(packed)
    mapped = ip.ipv4_mapped if isinstance(ip, ipaddress.IPv6Address) else None
    return f"[{ip}]:{port}" if mapped is None and ip.version == 6 else f"{mapped or ip}:{port}"
