"""Which processes of a run are still there after its end. Linux only: it looks in /proc."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from sim_server.run_folder import LOGS, RUN

PROC = Path("/proc")
LISTENING = re.compile(r"^run \S+ at (\S+), waiting for ", re.MULTILINE)
"""The simulator's first line: its address is in the command line of everybody who connects to it."""


def left_over(folder: Path, proc: Path = PROC) -> list[str] | None:
    """Command lines of the processes that belong to the run of this folder; None if that cannot be told.

    A process belongs to it if its command line names the folder or the simulator's address, or if it is in the session
    of one of the agents, as what a law has started is.

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
    names = (str(folder), address[1])
    found = []
    for process in proc.glob("[0-9]*"):
        try:
            line = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
            session = _session((process / "stat").read_text(encoding="utf-8", errors="replace"))
        except OSError:
            continue  # it has ended
        if int(process.name) != os.getpid() and (session in sessions or any(name in line.split() for name in names)):
            found.append(line)
    return sorted(line for line in found if line)  # a zombie has no command line: it has ended as well


def _session(stat: str) -> int:
    """Field 6 of /proc/<pid>/stat; the second, a name in brackets, may have blanks and brackets in it."""
    return int(stat.rpartition(")")[2].split()[3])
