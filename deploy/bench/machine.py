"""What a bench ran on: cores, Python and how it was built, versions, commit. No name of the machine, no path."""

from __future__ import annotations

import os
import platform
import re
import sys
import sysconfig
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sim_server.run_description import versions


def describe_machine() -> dict[str, Any]:
    """For JSON. What this system does not tell is None."""
    return {
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        "system": f"{platform.system()} {platform.release()}",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "cores_usable": len(os.sched_getaffinity(0)) if sys.platform == "linux" else None,
        "memory_MB": _memory_MB(),
        "load_average": os.getloadavg()[0],
        "python": {
            "implementation": platform.python_implementation(),
            "version": platform.python_version(),
            **_how_built(),
        },
        "versions": versions(),
    }


def _how_built() -> dict[str, bool]:
    """Whether this Python was compiled with optimisation, with profiles (PGO) and across modules (LTO)."""
    flags = " ".join(str(sysconfig.get_config_var(name) or "") for name in ("OPT", "PY_CFLAGS"))
    asked = str(sysconfig.get_config_var("CONFIG_ARGS") or "")
    return {
        "optimised": bool(re.search(r"-O[23s]\b", flags)),
        "profile_guided": "--enable-optimizations" in asked,
        "link_time": "--with-lto" in asked,
        "debug": bool(sysconfig.get_config_var("Py_DEBUG")),
    }


def _processor() -> str | None:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or None
    found = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return found[1] if found else platform.machine()


def _memory_MB() -> int | None:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 1_000_000
    except (OSError, ValueError):
        return None


def machine_text(machine: dict[str, Any]) -> str:
    """One line for a table's head."""
    python, found = machine["python"], machine["versions"]
    built = [name for name, key in (("PGO", "profile_guided"), ("LTO", "link_time")) if python[key]]
    how = ", ".join(built) or ("no PGO, no LTO" if python["optimised"] else "not optimised")
    commit = found["commit"]
    short = "no checkout" if commit is None else commit[:10] + ("+changes" if "+" in commit else "")
    return (
        f"{machine['cores']} cores, load {machine['load_average']:.1f}, Python {python['version']} ({how}), "
        f"MuJoCo {found['mujoco']}, Zenoh {found['eclipse-zenoh']}, commit {short}"
    )
