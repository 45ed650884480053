"""Which processes of a run are still there after its end. Linux only: it looks in /proc."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from sim_server.run_folder import LOGS, RUN

PROC = Path("/proc")
PARENT, SESSION = 4, 6
"""Fields of /proc/<pid>/stat."""
OURS = "deploy.cli"
"""In the command line of every process that a launcher starts."""
LISTENING = re.compile(r"^run \S+ at (\S+), waiting for ", re.MULTILINE)
"""The simulator's first line: its address is in the command line of everybody who connects to it."""


def left_over(folder: Path, proc: Path = PROC) -> list[str] | None:
    """Command lines of the processes that belong to the run of this folder; None if that cannot be told.

    A process belongs to it if it is one of ours that names the folder or the simulator's address, or if it is in the
    session of one of the agents, as what a law has started is. Who looks, and who has started them, does not.

    Args:
        folder: of a run that has ended, absolute.
        proc: where the system tells of its processes.
    """
    try:
        said = (folder / LOGS / "sim.log").read_text(encoding="utf-8", errors="replace")
        agents = json.loads((folder / RUN).read_text(encoding="utf-8"))["agents"]
        sessions = {int(agent["pid"]) for agent in agents.values() if agent["pid"]}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None
    address = LISTENING.search(said)
    if address is None or not (proc / "self").exists():
        return None
    names, above, found = {str(folder), address[1]}, _above(proc, os.getpid()), []
    for process in proc.glob("[0-9]*"):
        try:
            line = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
            session = _field(proc, process.name, SESSION)
        except OSError:
            continue  # it has ended
        words = set(line.split())
        belongs = session in sessions or (OURS in words and words & names)
        if belongs and int(process.name) not in above:
            found.append(line)
    return sorted(line for line in found if line)  # a zombie has no command line: it has ended as well


def _above(proc: Path, pid: int) -> set[int]:
    """A process and all that it comes from."""
    found: set[int] = set()
    while pid > 0 and pid not in found:
        found.add(pid)
        try:
            pid = _field(proc, str(pid), PARENT)
        except OSError:
            break
    return found


def _field(proc: Path, pid: str, number: int) -> int:
    """A field of /proc/<pid>/stat, from 1; the second, a name in brackets, may have blanks and brackets in it."""
    stat = (proc / pid / "stat").read_text(encoding="utf-8", errors="replace")
    return int(stat.rpartition(")")[2].split()[number - 3])
