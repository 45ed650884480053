"""A controller that tries everything on its machine, and writes to its own folder what it got. Loaded by test_walls."""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import platform
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agents.arm_model import ArmModel
from agents.controllers.paper import PaperController

PTRACE_SEIZE = 0x4206
IPC_RMID = 0


def attempts(aim: dict[str, Any]) -> dict[str, Callable[[], object]]:
    """What it tries; ``aim`` names the victim's pid, files and ports."""
    pid, private = int(aim["pid"]), Path(aim["private"])

    def ptrace() -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
        if libc.ptrace(PTRACE_SEIZE, pid, None, None):
            raise OSError(ctypes.get_errno(), "ptrace")

    def connect(family: int, address: Any) -> None:
        with socket.socket(family) as probe:
            probe.connect(address)

    def bind() -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            probe.listen()

    libc = ctypes.CDLL(None, use_errno=True)

    def call(number: int, *arguments: object) -> int:
        """A system call of x86_64 by its number, where Python has no name for it."""
        return libc_checked(libc.syscall(ctypes.c_long(number), *arguments))

    def open_queue() -> None:
        call(71, call(68, 0x50414C51, 0o1600), IPC_RMID, None)

    def open_semaphore() -> None:
        call(66, call(64, 0x50414C51, 1, 0o1600), 0, IPC_RMID)

    def open_shared_memory() -> None:
        call(31, call(29, 0x50414C51, ctypes.c_size_t(4096), 0o1600), IPC_RMID, None)

    def listen(protocol: int) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM, protocol) as listener:
            listener.listen()  # at a port of the system's choice, without bind

    def fast_open() -> None:
        with socket.socket() as probe:
            probe.sendto(b"x", 0x20000000, ("127.0.0.1", int(aim["port"])))

    def watch() -> None:
        os.close(libc_checked(libc.inotify_init1(0)))

    def libc_checked(result: int) -> int:
        if result < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        return result

    def lock() -> None:
        with open(os.__file__, "rb") as shared:
            fcntl.flock(shared, fcntl.LOCK_SH)

    def range_lock() -> None:
        with open(os.__file__, "rb") as shared:
            fcntl.lockf(shared, fcntl.LOCK_SH | fcntl.LOCK_NB)

    def control_shared_file(*arguments: Any) -> None:
        with open(os.__file__, "rb") as shared:
            fcntl.fcntl(shared, *arguments)

    def lease() -> None:  # taking one, like leaving a hint, needs the file's owner
        control_shared_file(fcntl.F_GETLEASE)

    def watch_the_old_way() -> None:
        folder = os.open(Path(os.__file__).parent / "json", os.O_RDONLY)
        try:
            fcntl.fcntl(folder, fcntl.F_NOTIFY, fcntl.DN_ACCESS)
        finally:
            os.close(folder)

    def ask_for_block_size() -> None:
        """Stands for all that ioctl does with files: flags, versions. This one every file system has."""
        with open(os.__file__, "rb") as shared:
            fcntl.ioctl(shared, 2, bytes(4))

    def run_from_memory() -> None:
        """Landlock knows no files that are in no folder."""
        program = os.memfd_create("program")
        try:
            os.write(program, b"#!/nothing/there\n")
            child = os.fork()
            if child == 0:
                try:
                    os.execve(program, ["program"], {})
                except PermissionError:
                    os._exit(1)
                except OSError:
                    os._exit(0)  # it was begun: the interpreter that it names was looked for
            if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
                raise PermissionError(1, "exec")
        finally:
            os.close(program)

    # By number, so only where the numbers are known; of System V, whoever makes something takes it away again.
    by_number: dict[str, Callable[[], object]] = {
        "leave a message in the keyring": lambda: call(248, b"user", b"palanquin-q", b"x", ctypes.c_size_t(1), -4),
        "open a message queue": open_queue,
        "open a semaphore": open_semaphore,
        "open shared memory of System V": open_shared_memory,
        "be woken by another's processor time": lambda: call(222, ctypes.c_int(~pid << 3 | 2), None, bytes(8)),
        "read another's input and output priority": lambda: call(252, 1, pid),
        "show its memory again": lambda: call(157, 4, 1, 0, 0, 0),
    }
    return {
        **(by_number if platform.machine() == "x86_64" else {}),
        "open a udp socket": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).close(),
        "open a unix socket": lambda: socket.socket(socket.AF_UNIX).close(),
        "ask the kernel who is connected": lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 4).close(),
        "listen without bind": lambda: listen(0),
        "listen by multipath tcp": lambda: listen(262),
        "connect by fast open": fast_open,
        "limit another's processor time": lambda: resource.prlimit(pid, resource.RLIMIT_CPU, (1000, 1000)),
        "move another to one core": lambda: os.sched_setaffinity(pid, os.sched_getaffinity(0)),
        "slow another down": lambda: os.setpriority(os.PRIO_PROCESS, pid, 5),
        "set the priority of a whole group": lambda: os.setpriority(os.PRIO_PGRP, 0, os.nice(0)),
        "read another's priority": lambda: os.getpriority(os.PRIO_PROCESS, pid),
        "read another's scheduler": lambda: os.sched_getscheduler(pid),
        "read another's cores": lambda: os.sched_getaffinity(pid),
        "ask for the clock of another's processor time": lambda: time.clock_getres((~pid) << 3 | 2),
        "read another's processor time": lambda: time.clock_gettime((~pid) << 3 | 2),
        "leave a message in a file's attributes": lambda: os.setxattr(private, "user.q", b"0.1 0.2"),
        "leave a message in a file's times": lambda: os.utime(private, ns=(1, 2)),
        "leave a message in a file's mode": lambda: os.chmod(private, 0o640),
        "watch a folder": watch,
        "lock a shared file": lock,
        "lock a part of a shared file": range_lock,
        "look for a lease on a shared file": lease,
        "read a hint left in a shared file": lambda: control_shared_file(1035, bytes(8)),
        "control a shared file": ask_for_block_size,
        "watch a folder in the old way": watch_the_old_way,
        "run a program from memory": run_from_memory,
        "read another's private file": private.read_text,
        "list another's folder": lambda: os.listdir(private.parent),
        "write outside its folder": lambda: (private.parent / "was-here").write_text("x"),
        "overwrite another's file": lambda: private.open("r+").close(),
        "read a scenario of the simulator": Path(aim["scenario"]).read_text,
        "read another's memory": lambda: open(f"/proc/{pid}/mem", "rb").close(),
        "read another's environment": Path(f"/proc/{pid}/environ").read_bytes,
        "read another's command line": Path(f"/proc/{pid}/cmdline").read_bytes,
        "list all processes": lambda: os.listdir("/proc"),
        "count connections": Path("/proc/self/net/tcp").read_text,
        "shared memory": lambda: Path("/dev/shm/palanquin-was-here").write_text("x"),
        "run a program": lambda: subprocess.run([sys.executable, "-c", ""], check=True),
        "connect to another port": lambda: connect(socket.AF_INET, ("127.0.0.1", int(aim["port"]))),
        "connect to an abstract socket": lambda: connect(socket.AF_UNIX, "\0" + aim["abstract"]),
        "listen on a port": bind,
        "attach as a debugger": ptrace,
        "look whether another is alive": lambda: os.kill(pid, 0),
        "stop another": lambda: os.kill(pid, signal.SIGTERM),
    }


def result(attempt: Callable[[], object]) -> str:
    try:
        attempt()
    except OSError as error:
        return f"denied: {error.strerror}"
    return "done"


class Hostile(PaperController):
    """Tries it all, then ends the process."""

    def __init__(self, arm: ArmModel, aim: str = "{}") -> None:
        Path("tried.json").write_text(
            json.dumps({name: result(each) for name, each in attempts(json.loads(aim)).items()})
        )
        os._exit(0)


class Curious(PaperController):
    """The paper's law, which says in its log what it can see of its own process."""

    def __init__(self, arm: ArmModel) -> None:
        super().__init__(arm)
        seen = {
            "cwd": os.getcwd(),
            "inside": os.listdir("."),
            "environment": sorted(os.environ),
            "output": os.readlink("/proc/self/fd/1"),
            "open": sorted(
                {os.readlink(f"/proc/self/fd/{k}") for k in range(3, 64) if os.path.lexists(f"/proc/self/fd/{k}")}
            ),
            "arguments": sys.argv[1:],
            "engines": sorted({"mujoco", "pinocchio"} & sys.modules.keys()),
        }
        print("curious: " + json.dumps(seen), flush=True)
