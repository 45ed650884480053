"""Seccomp: the system calls that an agent has no use for, denied. What Landlock does not know of is shut here.

A filter is a small program that the kernel runs at every call
(https://docs.kernel.org/userspace-api/seccomp_filter.html). This one allows everything but a list: every way to listen,
every socket but plain TCP, everything that reaches other processes, and what two processes of one user could leave
messages in (locks, times and attributes of files, keys, queues).
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import struct
import sys
from collections.abc import Mapping

_PR_SET_SECCOMP, _MODE_FILTER = 22, 2
_LOAD, _JUMP_EQUAL, _JUMP_AT_LEAST, _JUMP_ANY_BIT, _AND, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x54, 0x06
_ALLOW, _ERRNO = 0x7FFF0000, 0x00050000
_DENY = _ERRNO | errno.EPERM
_NUMBER, _ARCHITECTURE = 0, 4
_X32 = 0x40000000

_MACHINES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}

# Name: number on x86_64, on aarch64 (None: it has no such call).
NEVER: Mapping[str, tuple[int | None, int | None]] = {
    # nobody is listened to
    "bind": (49, 200), "listen": (50, 201), "accept": (43, 202), "accept4": (288, 242),
    # other processes
    "ptrace": (101, 117), "process_vm_readv": (310, 270), "process_vm_writev": (311, 271), "kcmp": (312, 272),
    "pidfd_open": (434, 434), "pidfd_send_signal": (424, 424), "pidfd_getfd": (438, 438),
    "process_madvise": (440, 440), "perf_event_open": (298, 241),
    # messages left in files that may not be written: attributes, times, modes, locks, and news of them
    "setxattr": (188, 5), "lsetxattr": (189, 6), "fsetxattr": (190, 7), "setxattrat": (463, 463),
    "removexattr": (197, 14), "lremovexattr": (198, 15), "fremovexattr": (199, 16),
    "chmod": (90, None), "fchmod": (91, 52), "fchmodat": (268, 53), "fchmodat2": (452, 452),
    "chown": (92, None), "fchown": (93, 55), "lchown": (94, None), "fchownat": (260, 54),
    "utime": (132, None), "utimes": (235, None), "utimensat": (280, 88), "futimesat": (261, None), "flock": (73, 32),
    "inotify_init": (253, None), "inotify_init1": (294, 26), "inotify_add_watch": (254, 27),
    "fanotify_init": (300, 262),
    "file_setattr": (469, 469), "mincore": (27, 232), "cachestat": (451, 451), "syslog": (103, 116),
    # programs: Landlock does not see one that lies in memory only (memfd)
    "execve": (59, 221), "execveat": (322, 281),
    # keys, queues, semaphores, shared memory
    "add_key": (248, 217), "request_key": (249, 218), "keyctl": (250, 219),
    "msgget": (68, 186), "msgsnd": (69, 189), "msgrcv": (70, 188), "msgctl": (71, 187),
    "semget": (64, 190), "semop": (65, 193), "semctl": (66, 191), "semtimedop": (220, 192),
    "shmget": (29, 194), "shmat": (30, 196), "shmctl": (31, 195), "mq_open": (240, 180), "mq_unlink": (241, 181),
    # ways around this filter
    "io_uring_setup": (425, 425), "io_uring_enter": (426, 426), "io_uring_register": (427, 427), "bpf": (321, 280),
    "userfaultfd": (323, 282), "unshare": (272, 97), "setns": (308, 268), "mount": (165, 40), "umount2": (166, 39),
    "pivot_root": (155, 41), "chroot": (161, 51), "name_to_handle_at": (303, 264), "open_by_handle_at": (304, 265),
}  # fmt: skip
SOMETIMES: Mapping[str, tuple[int, int]] = {
    "socket": (41, 198), "sendto": (44, 206), "sendmsg": (46, 211), "sendmmsg": (307, 269), "prlimit64": (302, 261),
    "sched_setaffinity": (203, 122), "sched_setscheduler": (144, 119), "sched_setparam": (142, 118),
    "sched_setattr": (314, 274), "setpriority": (141, 140), "ioprio_set": (251, 30), "clock_gettime": (228, 113),
    "fcntl": (72, 25), "prctl": (157, 167), "clone": (56, 220), "clone3": (435, 435), "ioctl": (16, 29),
    "getpriority": (140, 141), "ioprio_get": (252, 31), "sched_getaffinity": (204, 123),
    "sched_getscheduler": (145, 120), "sched_getparam": (143, 121), "sched_getattr": (315, 275),
    "sched_rr_get_interval": (148, 127),
    "clock_getres": (229, 114), "clock_nanosleep": (230, 115), "timer_create": (222, 107),
}  # fmt: skip

_FAST_OPEN = 0x20000000
_NEW_NAMESPACES = 0x7E020000
_FILE_LOCKS = (5, 6, 7, 36, 37, 38)
_LEASES_AND_NOTICES = (1024, 1025, 1026)
"""A lease is a lock on a file that may only be read; a notice (dnotify) tells who else reads in a folder."""
_WRITE_HINTS = (1035, 1036, 1037, 1038)
"""They stay with the file, for all who open it."""
_HARMLESS_IOCTLS = (0x5401, 0x802C542A, 0x5413, 0x5411, 0x541B, 0x5421, 0x5450, 0x5451)
"""Is it a terminal, how wide, how much waits, without blocking, closed in programs. All others are denied: some leave
flags in files that may only be read, one types into the terminal."""
_PRIO_PROCESS, _IOPRIO_WHO_PROCESS = 0, 1
_PR_SET_DUMPABLE = 4
_STREAM, _TCP = 1, 6
_INET, _INET6 = 2, 10

Program = list[bytes]


def _step(code: int, k: int, if_true: int = 0, if_false: int = 0) -> bytes:
    return struct.pack("=HBBI", code, if_true, if_false, k)


def _argument(index: int) -> bytes:
    """Load the lower half of an argument; none that is looked at has more."""
    return _step(_LOAD, 16 + 8 * index)


def _give(answer: int) -> bytes:
    return _step(_RETURN, answer)


def _deny_unless_zero(index: int) -> Program:
    return [_argument(index), _step(_JUMP_EQUAL, 0, 0, 1), _give(_ALLOW), _give(_DENY)]


def _deny_unless_itself(index_of_kind: int, process: int, index_of_id: int) -> Program:
    """Number 0 is oneself only as a process: as a user it is everybody's."""
    kind = [_argument(index_of_kind), _step(_JUMP_EQUAL, process, 1, 0), _give(_DENY)]
    return [*kind, *_deny_unless_zero(index_of_id)]


def _allow_if_one_of(index: int, values: tuple[int, ...]) -> Program:
    checks = [part for value in values for part in (_step(_JUMP_EQUAL, value, 0, 1), _give(_ALLOW))]
    return [_argument(index), *checks, _give(_DENY)]


def _deny_if_any_bit(index: int, bits: int) -> Program:
    return [_argument(index), _step(_JUMP_ANY_BIT, bits, 0, 1), _give(_DENY), _give(_ALLOW)]


def _deny_if_one_of(index: int, values: tuple[int, ...]) -> Program:
    checks = [part for value in values for part in (_step(_JUMP_EQUAL, value, 0, 1), _give(_DENY))]
    return [_argument(index), *checks, _give(_ALLOW)]


_CONDITIONS: Mapping[str, Program] = {
    # IPv4 or IPv6, a stream, and protocol 0 or TCP: no UDP, netlink, raw, packet, vsock, Unix or multipath socket.
    "socket": [
        _argument(0),
        _step(_JUMP_EQUAL, _INET, 2, 0),
        _step(_JUMP_EQUAL, _INET6, 1, 0),
        _give(_DENY),
        _argument(1),
        _step(_AND, 0xF),
        _step(_JUMP_EQUAL, _STREAM, 1, 0),
        _give(_DENY),
        _argument(2),
        _step(_JUMP_EQUAL, 0, 2, 0),
        _step(_JUMP_EQUAL, _TCP, 1, 0),
        _give(_DENY),
        _give(_ALLOW),
    ],
    "sendto": _deny_if_any_bit(3, _FAST_OPEN),  # connects past Landlock's rule
    "sendmsg": _deny_if_any_bit(2, _FAST_OPEN),
    "sendmmsg": _deny_if_any_bit(3, _FAST_OPEN),
    "prlimit64": _deny_unless_zero(0),  # limits of others: a limit of processor time kills
    "sched_setaffinity": _deny_unless_zero(0),
    "sched_setscheduler": _deny_unless_zero(0),
    "sched_setparam": _deny_unless_zero(0),
    "sched_setattr": _deny_unless_zero(0),
    "setpriority": _deny_unless_itself(0, _PRIO_PROCESS, 1),
    "ioprio_set": _deny_unless_itself(0, _IOPRIO_WHO_PROCESS, 1),
    # What one process sets for itself must not be read by another: that would be a message.
    "getpriority": _deny_unless_itself(0, _PRIO_PROCESS, 1),
    "ioprio_get": _deny_unless_itself(0, _IOPRIO_WHO_PROCESS, 1),
    "sched_getscheduler": _deny_unless_zero(0),
    "sched_getparam": _deny_unless_zero(0),
    "sched_getattr": _deny_unless_zero(0),
    "sched_rr_get_interval": _deny_unless_zero(0),
    # The C library asks this of its own threads by number, and takes "no such call" for an answer.
    "sched_getaffinity": [_argument(0), _step(_JUMP_EQUAL, 0, 0, 1), _give(_ALLOW), _give(_ERRNO | errno.ENOSYS)],
    # The processor time of another process: read, waited for, or rung a bell by.
    "clock_gettime": _deny_if_any_bit(0, 1 << 31),
    "clock_getres": _deny_if_any_bit(0, 1 << 31),
    "clock_nanosleep": _deny_if_any_bit(0, 1 << 31),
    "timer_create": _deny_if_any_bit(0, 1 << 31),
    "fcntl": _deny_if_one_of(1, _FILE_LOCKS + _LEASES_AND_NOTICES + _WRITE_HINTS),
    "ioctl": _allow_if_one_of(1, _HARMLESS_IOCTLS),
    "prctl": _deny_if_one_of(0, (_PR_SET_DUMPABLE,)),
    "clone": _deny_if_any_bit(0, _NEW_NAMESPACES),
    "clone3": [_give(_ERRNO | errno.ENOSYS)],  # its flags cannot be seen; the C library then uses clone
}


class _Filter(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("steps", ctypes.c_char_p))


def filter_program(machine: str) -> bytes:
    """The filter for a machine as :func:`platform.machine` names it. Raises :class:`KeyError` for an unknown one."""
    column = list(_MACHINES).index(machine)
    program = [
        _step(_LOAD, _ARCHITECTURE),
        _step(_JUMP_EQUAL, _MACHINES[machine], 1, 0),
        _give(_DENY),
        _step(_LOAD, _NUMBER),
        *([_step(_JUMP_AT_LEAST, _X32, 0, 1), _give(_DENY)] if machine == "x86_64" else []),
    ]
    for numbers in NEVER.values():
        number = numbers[column]
        if number is not None:
            program += [_step(_JUMP_EQUAL, number, 0, 1), _give(_DENY)]
    for name, condition in _CONDITIONS.items():
        program += [_step(_JUMP_EQUAL, SOMETIMES[name][column], 0, len(condition)), *condition]
    return b"".join([*program, _give(_ALLOW)])


def restrict_calls() -> bool:
    """Put the filter on this thread and those it starts from now on; False where there is none for this machine. The
    thread must have no new privileges already.

    Raises:
        OSError: the kernel refused.
    """
    if sys.platform != "linux" or platform.machine() not in _MACHINES:
        return False
    steps = filter_program(platform.machine())
    wanted = _Filter(len(steps) // 8, steps)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(wanted), 0, 0):
        raise OSError(ctypes.get_errno(), f"seccomp: {os.strerror(ctypes.get_errno())}")
    return True


def drop_capabilities() -> None:
    """Give up all that root may do beyond an ordinary user, for good: also what a program would get back."""
    libc = ctypes.CDLL(None, use_errno=True)
    for capability in range(64):
        libc.prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP; fails for those that are not there, or not ours
    header, nothing = struct.pack("=Ii", 0x20080522, 0), bytes(24)
    if libc.capset(header, nothing):
        raise OSError(ctypes.get_errno(), f"capset: {os.strerror(ctypes.get_errno())}")
