"""Landlock, the Linux kernel's walls that a process raises around itself, through its three system calls.

https://docs.kernel.org/userspace-api/landlock.html. A right that is *handled* is denied everywhere but where a rule
gives it back. What a kernel does not know yet is left out, and :class:`Enforced` says so.
"""

from __future__ import annotations

import ctypes
import os
import stat
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

# The same numbers on every architecture that Linux has had since 2021, but for alpha.
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_VERSION_FLAG = 1
_PATH_BENEATH, _NET_PORT = 1, 2

EXECUTE, WRITE_FILE, READ_FILE, READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
TRUNCATE, IOCTL_DEV = 1 << 14, 1 << 15
OF_A_FILE = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL_DEV
"""The rights that a rule about a file, not a folder, may give."""
EVERYTHING = (1 << 16) - 1
READ = READ_FILE | READ_DIR
OWN = EVERYTHING & ~(EXECUTE | IOCTL_DEV | 1 << 6 | 1 << 11)
"""Read, write, make and remove, but no program is run there and no device made."""
CONNECT_TCP = 1 << 1

_FILES_SINCE_ABI = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 5: (1 << 16) - 1}
_NET_SINCE, _SCOPE_SINCE = 4, 6
_BIND_AND_CONNECT, _UNIX_AND_SIGNALS = 0b11, 0b11


class _RulesetAttr(ctypes.Structure):
    _fields_ = (("fs", ctypes.c_uint64), ("net", ctypes.c_uint64), ("scoped", ctypes.c_uint64))


class _PathBeneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("allowed", ctypes.c_uint64), ("parent", ctypes.c_int32))


class _NetPort(ctypes.Structure):
    _fields_ = (("allowed", ctypes.c_uint64), ("port", ctypes.c_uint64))


@dataclass(frozen=True, slots=True)
class Enforced:
    """Which walls stand."""

    abi: int
    """Of the kernel's Landlock; 0: it has none."""
    walls: tuple[str, ...]
    missing: tuple[str, ...] = ()


def abi() -> int:
    """The version of the kernel's Landlock; 0 where there is none."""
    if sys.platform != "linux":
        return 0
    return max(0, _call(_CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(_VERSION_FLAG)))


def restrict(files: Mapping[Path, int], connect_ports: Iterable[int]) -> Enforced:
    """Shut this thread, and those it starts from now on, in: ``files`` gives rights below paths, those that do not
    exist are passed over. The thread must have no new privileges already.

    Raises:
        OSError: the kernel has Landlock, but refused.
    """
    version = abi()
    if version == 0:
        return Enforced(0, (), ("files", "programs", "ptrace", "tcp", "signals"))
    handled = _FILES_SINCE_ABI[max(since for since in _FILES_SINCE_ABI if since <= version)]
    has_net, has_scope = version >= _NET_SINCE, version >= _SCOPE_SINCE
    attr = _RulesetAttr(handled, _BIND_AND_CONNECT if has_net else 0, _UNIX_AND_SIGNALS if has_scope else 0)
    size = 8 * (1 + has_net + has_scope)
    ruleset = _checked(_CREATE_RULESET, ctypes.byref(attr), ctypes.c_size_t(size), ctypes.c_uint32(0))
    try:
        for path, rights in files.items():
            _allow_below(ruleset, path, rights & handled)
        for port in connect_ports if has_net else ():
            rule = _NetPort(CONNECT_TCP, port)
            _checked(_ADD_RULE, ruleset, _NET_PORT, ctypes.byref(rule), ctypes.c_uint32(0))
        _checked(_RESTRICT_SELF, ruleset, ctypes.c_uint32(0))
    finally:
        os.close(ruleset)
    stand = ["files", "programs", "ptrace", *(["tcp"] if has_net else []), *(["signals"] if has_scope else [])]
    missing = [*([] if has_net else ["tcp"]), *([] if has_scope else ["signals"])]
    return Enforced(version, tuple(stand), tuple(missing))


def _allow_below(ruleset: int, path: Path, rights: int) -> None:
    try:
        parent = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        if not stat.S_ISDIR(os.fstat(parent).st_mode):
            rights &= OF_A_FILE
        rule = _PathBeneath(rights, parent)
        _checked(_ADD_RULE, ruleset, _PATH_BENEATH, ctypes.byref(rule), ctypes.c_uint32(0))
    finally:
        os.close(parent)


def _call(number: int, *arguments: object) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.syscall.restype = ctypes.c_long
    return int(libc.syscall(ctypes.c_long(number), *arguments))


def _checked(number: int, *arguments: object) -> int:
    result = _call(number, *arguments)
    if result < 0:
        raise OSError(ctypes.get_errno(), f"Landlock: {os.strerror(ctypes.get_errno())}")
    return result
