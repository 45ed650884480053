"""A room for an agent that the launcher starts: a folder and an environment of its own, and a pipe for what it prints.

Not a log file: a process can see the path of a file that it has open, and from there how many others there are.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO

KEPT = ("LANG", "LANGUAGE", "LC_ALL", "LC_CTYPE", "TZ", "LD_LIBRARY_PATH", "RUST_LOG", "SYSTEMROOT")
"""What an agent gets of the launcher's environment, besides what is made for it. No PATH: it starts no program."""


PREFIX = "palanquin-room-"
"""How the name of every room begins."""


class Rooms:
    """The rooms of one run; they go with everything in them, and with those that a launcher left that was killed."""

    def __init__(self) -> None:
        self._folders: dict[Path, int] = {}
        """Each with the descriptor that locks it while this launcher lives."""
        self._pumps: list[threading.Thread] = []
        sweep()

    def make(self) -> Path:
        """A folder that only this user can enter; its name tells nothing, of its neighbours neither."""
        while True:
            folder = Path(tempfile.mkdtemp(prefix=PREFIX)).resolve()
            try:
                lock = os.open(folder, os.O_RDONLY)
            except FileNotFoundError:
                continue  # swept
            fcntl.flock(lock, fcntl.LOCK_EX)
            if folder.exists():
                self._folders[folder] = lock
                return folder
            os.close(lock)

    def keep_log(self, process: subprocess.Popen[bytes], log: Path) -> None:
        """Write what the process prints to ``log``, until it has ended."""
        output: IO[bytes] | None = process.stdout
        if output is None:
            return

        def pump() -> None:
            with log.open("wb", buffering=0) as file:
                while said := output.read1(65536):  # type: ignore[attr-defined]  # a BufferedReader
                    file.write(said)

        thread = threading.Thread(target=pump, name=f"log of {log.stem}", daemon=True)
        thread.start()
        self._pumps.append(thread)

    def clear(self) -> None:
        """Remove the rooms; what their owners printed last is written first."""
        for pump in self._pumps:
            pump.join(1.0)
        for folder, lock in self._folders.items():
            shutil.rmtree(folder, ignore_errors=True)
            os.close(lock)
        self._folders.clear()


def sweep() -> None:
    """Remove empty rooms that nobody locks any more: their launcher was killed, and their agents went with it."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # somebody's own, in use, not empty, or gone meanwhile: not ours to remove
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                if os.fstat(lock).st_uid == os.getuid():
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    folder.rmdir()
            finally:
                os.close(lock)


def room_environment(environment: Mapping[str, str], room: Path, code: Path) -> dict[str, str]:
    """A small, explicit environment: no secret of the launcher's comes along. ``code`` is where the user's own
    controller may lie."""
    kept = {name: environment[name] for name in KEPT if name in environment}
    path = ":".join([str(code), *filter(None, [environment.get("PYTHONPATH", "")])])
    return kept | {"HOME": str(room), "TMPDIR": str(room), "PYTHONPATH": path}
