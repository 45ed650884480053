"""What a process holds in memory and has used of processor time, as Linux counts it."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

KB_PER_MB = 1000 / 1.024
"""The kernel's kB are 1024 bytes, our MB 10^6."""


@dataclass(frozen=True, slots=True)
class Memory:
    """Of one process."""

    rss_MB: float
    """All pages that it has in memory, those that it shares included."""
    pss_MB: float | None
    """Shared pages divided by those who share them; None if the kernel does not tell us."""


def memory_of(pid: int) -> Memory | None:
    """None where this cannot be told: no Linux, or the process is gone."""
    rss = _kB(Path(f"/proc/{pid}/status"), "VmRSS")
    if rss is None:
        return None
    pss = _kB(Path(f"/proc/{pid}/smaps_rollup"), "Pss")  # needs the rights of a debugger
    return Memory(rss / KB_PER_MB, None if pss is None else pss / KB_PER_MB)


def cpu_s_of(pid: int) -> float | None:
    """Processor time of all its threads so far, s; the kernel counts in steps of 10 ms. None where it is not told."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _kB(file: Path, name: str) -> int | None:
    try:
        found = re.search(rf"^{name}:\s+(\d+) kB$", file.read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:
        return None
    return int(found[1]) if found else None
