"""What an intruder tries on the machine that it runs on, past the wire: files and processes of others, a port."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

from deploy.chaos.attempt import Attempt, Got
from deploy.chaos.target import Target


def _reads(target: Target) -> Got:
    read = [path for path in target.private if _works(path.read_bytes)]
    return Got(bool(read), f"{len(read)} of {len(target.private)} files read")


def _each_process(what: str, act: Callable[[int], object]) -> Callable[[Target], Got]:
    def attempt(target: Target) -> Got:
        done = [pid for pid in target.pids if _works(lambda pid=pid: act(pid))]  # type: ignore[misc]
        return Got(bool(done), f"{what} {len(done)} of {len(target.pids)} processes")

    return attempt


def _works(act: Callable[[], object]) -> bool:
    try:
        act()
    except OSError:
        return False
    return True


def _listens(target: Target) -> Got:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return Got(True, f"listens on port {server.getsockname()[1]}")


ON_THE_HOST: tuple[Attempt, ...] = (
    Attempt("read files of others", "host", _reads),
    Attempt(
        "read the environment of others",
        "host",
        _each_process("read that of", lambda pid: Path(f"/proc/{pid}/environ").read_bytes()),
    ),
    Attempt(
        "read the memory of others",
        "host",
        _each_process("opened that of", lambda pid: open(f"/proc/{pid}/mem", "rb").close()),
    ),
    Attempt("signal others", "host", _each_process("could signal", lambda pid: os.kill(pid, 0))),
    Attempt("listen on a port", "host", _listens),
    Attempt("list processes", "host", lambda target: Got(True, f"{len(os.listdir('/proc'))} entries in /proc")),
)
