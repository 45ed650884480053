"""The walls around an agent's process: what Zenoh cannot keep from it, the operating system does.

An agent reads Python, its libraries and its controller's code; writes its own folder; connects by TCP to the
simulator's port; and reaches no other process. Landlock holds what it knows, a filter of system calls the rest, and
what root may do is given up. Raised before any of the user's code is loaded and before any other thread is started,
since all of it holds for the thread that asks and its children. Linux only; elsewhere nothing is enforced, and the
statement says so.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import pkgutil
import site
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from deploy.landlock import IOCTL_DEV, OWN, READ, READ_DIR, READ_FILE, WRITE_FILE, abi, restrict
from deploy.seccomp import drop_capabilities, restrict_calls
from wire.endpoints import parse_endpoint

SAYS = "walls: "
"""How the line begins in which an agent's log says which walls stand."""

_PR_SET_DUMPABLE, _PR_SET_NO_NEW_PRIVS = 4, 38

SYSTEM = (
    *("/lib", "/lib32", "/lib64", "/usr/lib", "/usr/lib32", "/usr/lib64", "/usr/local/lib"),
    *("/usr/share/locale", "/usr/share/zoneinfo", "/etc/localtime", "/etc/ld.so.cache", "/etc/ld.so.conf.d"),
    *("/etc/hosts", "/etc/host.conf", "/etc/nsswitch.conf", "/etc/resolv.conf", "/etc/gai.conf", "/etc/ssl"),
    *("/sys/devices/system/cpu", "/dev/urandom", "/dev/random"),
)
"""Nothing of /proc: it tells of other processes, and of everybody's connections."""
CODE = (".py", ".pyc", ".so")
OURS = ("agents", "wire", "deploy")
NOT_FOR_AGENTS = "sim_server"
"""Our package that holds the scenarios: loads, goals, teams."""


def raise_walls(port: int, own: Path) -> str:
    """Shut this process in and say which walls stand; ``own`` is its folder, ``port`` the simulator's.

    Raises:
        OSError: the kernel has walls, but refused to raise them.
    """
    if sys.platform != "linux":
        return f"none: {sys.platform} has no Landlock"
    if len(os.listdir("/proc/self/task")) > 1:
        raise RuntimeError("walls are raised before any thread is started")
    _hold_listings()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    libc.prctl(_PR_SET_DUMPABLE, 0, 0, 0, 0)
    drop_capabilities()
    others = "no new privileges, no capabilities, memory hidden from processes of the same user"
    if abi() == 0:
        return _with_filter(f"{others}; files, tcp and signals not enforced: this kernel has no Landlock")
    allowed = {path: READ for path in readable()}
    allowed |= {path: READ_DIR for path in _package_folders()}
    allowed |= {Path("/dev/null"): READ_FILE | WRITE_FILE | IOCTL_DEV, own: OWN}
    enforced = restrict(allowed, [port])
    text = f"landlock abi {enforced.abi}: {', '.join(enforced.walls)}; {others}"
    return _with_filter(
        text + (f"; not enforced on this kernel: {', '.join(enforced.missing)}" if enforced.missing else "")
    )


def shut_in(connect: str) -> str:
    """Raise the walls of an agent of the simulator at this address, around its working folder; the line that says so.

    Raises:
        LinkError: no address.
        OSError: see :func:`raise_walls`.
    """
    return SAYS + raise_walls(parse_endpoint(connect).port, Path.cwd())


def _with_filter(text: str) -> str:
    """Raise the last wall, which would be in the way of the others, and say so."""
    return f"{text}; {'system calls filtered' if restrict_calls() else 'system calls not filtered on this machine'}"


def readable() -> Iterator[Path]:
    """What an agent may read: the system's libraries, Python, what is installed, ours without the simulator, and code
    on the path of the user's own."""
    yield from map(Path, SYSTEM)
    paths = sysconfig.get_paths()
    yield from {Path(paths["stdlib"]), Path(paths["platstdlib"]), Path(sys.base_prefix) / "lib"}
    for folder in _package_folders():
        yield from (each for each in _listed(folder) if each.name != NOT_FOR_AGENTS)
    for name in OURS:
        spec = importlib.util.find_spec(name)
        yield from map(Path, (spec.submodule_search_locations or ()) if spec else ())
    for folder in _own_code_folders():
        yield from (each for each in _listed(folder) if _is_code(each))


def _package_folders() -> set[Path]:
    """Where installed packages are: their names may be listed, the simulator's content not read."""
    paths = sysconfig.get_paths()
    return {Path(folder) for folder in (paths["purelib"], paths["platlib"], *site.getsitepackages())}


def _own_code_folders() -> list[Path]:
    """Folders of the user's on the module path, such as where `palanquin run` was typed."""
    python = {Path(sysconfig.get_paths()[name]) for name in ("stdlib", "platstdlib")} | _package_folders()
    folders = [Path(entry).resolve() for entry in sys.path if entry and Path(entry).is_dir()]
    return [folder for folder in folders if folder not in python and not python & set(folder.parents)]


def _is_code(path: Path) -> bool:
    if path.is_dir():
        has_code = os.path.exists(path / "__init__.py")  # False for a folder of somebody else, where pathlib raises
        return path.name == "__pycache__" or (has_code and path.name != NOT_FOR_AGENTS)
    return path.suffix in CODE


def _listed(folder: Path) -> Iterable[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return ()


def _hold_listings() -> None:
    """Have Python list the user's folders now and never again: the right to list a folder would show all below it,
    such as `runs/` and in it the number and names of the others."""
    for folder in _own_code_folders():
        for entry in {entry for entry in sys.path if entry and Path(entry).resolve() == folder}:
            finder: Any = pkgutil.get_importer(entry)
            if hasattr(finder, "_fill_cache"):
                finder.find_spec("palanquin_lists_this_folder")
                finder._fill_cache = lambda: None


def walls_in_log(log: Path) -> str:
    """Which walls an agent said to stand around it; empty if it did not."""
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    return next((line.removeprefix(SAYS) for line in lines if line.startswith(SAYS)), "")
