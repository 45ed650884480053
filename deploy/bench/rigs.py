"""A bare transport with its processes: one hub and an agent for every arm and the leader, ready to tick on demand."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Self

from deploy.bench.bare import as_words
from deploy.bench.transports import Talk
from deploy.exit_status import COULD_NOT_RUN
from deploy.launcher import child_environment
from wire.codec import encode
from wire.credentials import credential_line, for_one_run, guests_line
from wire.endpoints import parse_endpoint
from wire.messages import Command, LeaderForce, LeaderView, State
from wire.zenoh_link import free_endpoint

TRANSPORTS = {"zenoh": "bare Zenoh", "zmq": "ZeroMQ", "sockets": "raw Unix sockets"}
"""Every transport, with its name in a table."""
TICKS, TIME_NS, STEP_NS = 10_000, 10_000_000_000, 30_000
"""Of a message somewhere in a run: whole numbers are longer the greater they are."""
LEADER_EVERY = 10
END_S = 3.0


class RigFailed(Exception):
    """The processes of a bare transport did not come about, or broke."""

    exit_status = COULD_NOT_RUN


def has_peer() -> bool:
    """Whether ZeroMQ is installed."""
    return find_spec("zmq") is not None


NO_PEER = "ZeroMQ is left out: pyzmq is not installed; expected the extra `bench`: pip install 'palanquin[bench]'"


def talks_of(arms: Sequence[str], joints: int = 7) -> list[Talk]:
    """What passes in a tick of a run with these arms and a leader: sizes of our own messages."""
    some, three, six = (0.1,) * joints, (0.1,) * 3, (0.1,) * 6
    talks = []
    for arm in arms:
        state = State(arm, TICKS, TIME_NS, some, some, some, six, 0.03, six)
        command = Command(arm, TICKS, 1, some, three, 0.1, some, 0.1, STEP_NS)
        talks.append(Talk(arm, len(encode(state)), len(encode(command))))
    view = LeaderView(TICKS, TIME_NS, three, (*three, 0.1), three, three)
    force = LeaderForce(TICKS, 1, "front", three)
    return [*talks, Talk("leader", len(encode(view)), len(encode(force)), LEADER_EVERY)]


class Rig:
    """The processes of one transport; as a context they live in it. Between two turns they sleep.

    Args:
        transport: one of :data:`TRANSPORTS`.
        arms: their names.
    """

    def __init__(self, transport: str, arms: Sequence[str]) -> None:
        self._transport, self._talks = transport, talks_of(arms)
        self._processes: list[subprocess.Popen[bytes]] = []
        self._folder = tempfile.TemporaryDirectory(prefix="palanquin-")

    def __enter__(self) -> Self:
        try:
            self._start()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def _start(self) -> None:
        place, guests = self._place(), for_one_run([talk.name for talk in self._talks])
        secret = guests_line(guests) if self._transport == "zenoh" else b""
        self._hub = self._spawn("hub", place, self._talks, secret)
        self._expect("listening")
        for talk in self._talks:
            secret = credential_line(guests.of(talk.name)) if self._transport == "zenoh" else b""
            self._spawn("agent", place, [talk], secret)
        self._expect("ready")

    def _place(self) -> str:
        if self._transport == "sockets":
            return str(Path(self._folder.name) / "hub")
        endpoint = free_endpoint()
        return endpoint if self._transport == "zenoh" else f"tcp://127.0.0.1:{parse_endpoint(endpoint).port}"

    def _spawn(self, role: str, place: str, talks: Sequence[Talk], secret: bytes) -> subprocess.Popen[bytes]:
        log = Path(self._folder.name) / f"{len(self._processes)}.log"
        with log.open("wb") as errors:
            process = subprocess.Popen(
                [sys.executable, "-m", "deploy.bench.bare", role, self._transport, place, *map(as_words, talks)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE if role == "hub" else subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
                env=child_environment(os.environ),
            )
        self._processes.append(process)
        self._say(process, secret)
        return process

    def ticks_per_s(self, seconds: float) -> float:
        """Ticks a second, over so much wall time. Raises :class:`RigFailed`."""
        self._say(self._hub, f"{seconds!r}\n".encode())
        found = json.loads(self._line())
        return float(found["ticks"]) / float(found["wall_s"])

    def _say(self, process: subprocess.Popen[bytes], text: bytes) -> None:
        if process.stdin is not None:
            with suppress(BrokenPipeError):  # it has ended, and the line that is waited for will not come
                process.stdin.write(text)
                process.stdin.flush()

    def _line(self) -> str:
        line = self._hub.stdout.readline() if self._hub.stdout is not None else b""
        if not line:
            raise RigFailed(f"{TRANSPORTS[self._transport]}: a process of it ended: {self._last_words()}")
        return line.decode()

    def _expect(self, word: str) -> None:
        line = self._line().strip()
        if line != word:
            raise RigFailed(f"{TRANSPORTS[self._transport]}: got {line!r}, expected {word!r}")

    def _last_words(self) -> str:
        for log in sorted(Path(self._folder.name).glob("*.log")):
            lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
            if said := [line for line in lines if line.strip()]:
                return said[-1]
        return "it said nothing"

    def _end(self) -> None:
        for process in self._processes:
            if process.stdin is not None:
                with suppress(BrokenPipeError):
                    process.stdin.close()
        deadline = time.monotonic() + END_S
        for process in self._processes:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        self._folder.cleanup()
