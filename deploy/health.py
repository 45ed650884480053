"""Health of a container: whether the simulator listens, or an agent is connected to it.

``python -m deploy.health listening [PORT]`` or ``connected [PORT]``; status 0 if so, 1 if not, 2 for bad input. Reads
the kernel's table and knocks at no door: a check every few seconds must not cost the run a handshake.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

PORT = 7447
TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
"""Of this container's own network; documented in proc(5)."""
ESTABLISHED, LISTEN = 0x01, 0x0A


def holds(what: str, port: int, rows: Iterable[str]) -> bool:
    """Whether a row of the table says that a socket listens on ``port`` (``listening``), or that one is connected to it
    at the other end (``connected``).

    Args:
        rows: lines below the heading: number, local address, remote address, state, ... in hexadecimal.
    """
    for row in rows:
        _, local, remote, state, *_ = row.split()
        where, wanted = (local, LISTEN) if what == "listening" else (remote, ESTABLISHED)
        if int(state, 16) == wanted and int(where.rpartition(":")[2], 16) == port:
            return True
    return False


def main(arguments: list[str]) -> int:
    """Say what is so; the exit status."""
    what, port = arguments[0] if arguments else "", arguments[1] if len(arguments) > 1 else str(PORT)
    if what not in ("listening", "connected") or not port.isdigit() or len(arguments) > 2:
        print(f"health: got {' '.join(arguments) or 'nothing'}, expected listening or connected, and a port")
        return 2
    rows = [row for table in TABLES if table.exists() for row in table.read_text().splitlines()[1:]]
    well = holds(what, int(port), rows)
    print(f"{what}: {'yes' if well else 'no'}, port {port}")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
