"""A controller that tries everything on its machine, and writes to its own folder what it got. Loaded by test_walls."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agents.arm_model import ArmModel
from agents.controllers.paper import PaperController

PTRACE_SEIZE = 0x4206


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

    return {
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
        }
        print("curious: " + json.dumps(seen), flush=True)
