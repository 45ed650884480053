"""Real processes for tests: started in a session of their own, waited for with a deadline, ended in any case."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

PALANQUIN = Path(sys.executable).with_name("palanquin")
POLL_S = 0.02
PATIENCE_S = 120.0
"""Deadline for what takes a second or two on a machine that has nothing else to do."""


def wait_until(condition: Callable[[], object], what: str, deadline_s: float = PATIENCE_S) -> None:
    """Return as soon as ``condition()`` is true; fail with ``what`` if it is not in time."""
    deadline = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"waited {deadline_s:g} s for: {what}")
        time.sleep(POLL_S)


def run_to_end(
    *arguments: str | Path, cwd: Path, environment: Mapping[str, str] | None = None, patience_s: float = PATIENCE_S
) -> subprocess.CompletedProcess[str]:
    """A ``palanquin`` command that ends by itself."""
    return subprocess.run(
        [PALANQUIN, *arguments],
        cwd=cwd,
        env={**os.environ, **(environment or {})},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=patience_s,
        check=False,
        start_new_session=True,
    )


@dataclass(eq=False)
class Started:
    """A ``palanquin`` command that runs, and everybody that it started."""

    process: subprocess.Popen[bytes]
    output: Path
    errors: Path
    family: dict[int, psutil.Process] = field(default_factory=dict)

    def look(self) -> dict[int, psutil.Process]:
        """The command and its descendants as far as they are there now; whoever was seen once is remembered."""
        try:
            root = psutil.Process(self.process.pid)
            found = [root, *root.children(recursive=True)]
        except psutil.NoSuchProcess:
            found = []
        self.family |= {each.pid: each for each in found}
        return {each.pid: each for each in found}

    def said(self) -> str:
        """What it has printed so far on either output."""
        return self.output.read_text(errors="replace") + self.errors.read_text(errors="replace")

    def wait_until(self, condition: Callable[[], object], what: str, deadline_s: float = PATIENCE_S) -> None:
        """As :func:`wait_until`, but fail at once if the command ends meanwhile, and show what it said."""

        def there() -> bool:
            self.look()
            if condition():
                return True
            if self.process.poll() is not None:
                raise AssertionError(f"it ended with {self.process.returncode} before: {what}\n{self.said()}")
            return False

        try:
            wait_until(there, what, deadline_s)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.said()}") from None

    def end(self, deadline_s: float = PATIENCE_S) -> int:
        """Wait for its own end and return its exit status."""
        try:
            return self.process.wait(deadline_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"it has not ended after {deadline_s:g} s\n{self.said()}") from None

    def survivors(self) -> list[str]:
        """Command lines of those of its family who are still there."""
        alive = []
        for each in self.family.values():
            try:
                if each.is_running() and each.status() != psutil.STATUS_ZOMBIE:
                    alive.append(" ".join(each.cmdline()))
            except psutil.NoSuchProcess:
                continue
        return alive


@contextmanager
def started(*arguments: str | Path, cwd: Path, name: str = "palanquin") -> Iterator[Started]:
    """Start a ``palanquin`` command; whatever happens, nobody of its family outlives the block."""
    output, errors = cwd / f"{name}.out", cwd / f"{name}.err"
    with output.open("wb") as to, errors.open("wb") as errors_to:
        process = subprocess.Popen(
            [PALANQUIN, *arguments],
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            stdout=to,
            stderr=errors_to,
            start_new_session=True,
        )
    run = Started(process, output, errors)
    try:
        yield run
    finally:
        run.look()
        for each in run.family.values():
            try:
                each.kill()  # psutil does not kill another process that got the number meanwhile
            except psutil.NoSuchProcess:
                continue
        process.wait(10)


@contextmanager
def both_cores_busy() -> Iterator[None]:
    """A busy process for every core that the run may use."""
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True) for _ in range(2)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait(10)


def processes_that_name(text: str) -> list[str]:
    """Command lines on this machine that contain ``text``."""
    found = []
    for each in psutil.process_iter(["cmdline"]):
        line = " ".join(each.info["cmdline"] or [])
        if text in line and each.pid != os.getpid():
            found.append(line)
    return found


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def port_is_closed(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) != 0


class LaunchedRun:
    """A ``palanquin run`` with its folder, its events and its children by name."""

    def __init__(self, command: Started, folder: Path) -> None:
        self.command, self.folder = command, folder
        self.children: dict[str, psutil.Process] = {}
        self.port = 0

    def events(self) -> list[dict[str, Any]]:
        """Events so far; a line that is still being written is not there yet."""
        return read_events(self.folder)

    def has(self, kind: str, **details: object) -> bool:
        """Whether such an event has been written."""
        return any(
            event["kind"] == kind and all(event.get(key) == value for key, value in details.items())
            for event in self.events()
        )

    def simulated_s(self) -> float:
        """Simulated time that the last line of progress tells; negative before the first."""
        times = re.findall(r"^\s*([\d.]+) of \d+ s,", self.command.output.read_text(), re.MULTILINE)
        return float(times[-1]) if times else -1.0

    def wait_until_carrying(self, simulated_s: float) -> None:
        """Until the run has come this far; finds the children and the port on the way."""
        self.command.wait_until(
            lambda: self.simulated_s() >= simulated_s, f"{simulated_s:g} s of simulated time to have passed"
        )
        for each in self.command.look().values():
            try:
                line = each.cmdline()
            except psutil.NoSuchProcess:  # it has ended, as has what it was to do; its log says why
                continue
            for part in ("sim", "follower", "leader"):
                if "deploy.cli" in line and part in line:
                    name = line[line.index("--arm") + 1] if part == "follower" else part
                    self.children[name] = each
        endpoint = self.children["sim"].cmdline()
        self.port = int(endpoint[endpoint.index("--listen") + 1].rpartition(":")[2])

    def signal(self, child: str, number: signal.Signals) -> None:
        self.children[child].send_signal(number)

    def wait_until_nobody_is_left(self, deadline_s: float = 10.0) -> None:
        """Nobody of the family, nobody who names the folder or the port, and the port closed."""
        wait_until(lambda: not self.command.survivors(), "the children to be gone", deadline_s)
        assert processes_that_name(str(self.folder)) == []
        assert processes_that_name(f"127.0.0.1:{self.port}") == []
        assert port_is_closed(self.port)


def read_events(folder: Path) -> list[dict[str, Any]]:
    path = folder / "events.jsonl"
    if not path.exists():
        return []
    whole = path.read_text().rpartition("\n")[0]
    return [json.loads(line) for line in whole.splitlines()]


def read_json(path: Path) -> dict[str, Any]:
    found = json.loads(path.read_text())
    assert isinstance(found, dict)
    return found


HUNG = "the final look did not come back within "
"""A doubt of an audit: on a busy machine Zenoh may not tell in time who is connected. That harms nothing."""
UNKNOWN_CONNECTION = "whose connection from "
"""A doubt of an audit: whose a connection was cannot be told any more once it has gone, if it heard a little."""


def not_violated(audit: Mapping[str, Any], *doubts: str) -> None:
    """The audit holds, or it is unknown for these kinds of doubt and no other."""
    if audit["verdict"] != "holds":
        assert audit["verdict"] == "unknown", audit["why"]
        assert audit["why"]
        assert [why for why in audit["why"] if not why.startswith(doubts)] == []
        hung = any(why.startswith(HUNG) for why in audit["why"])
        assert hung == (not audit["final_look_came_back"]), audit["why"]


def settings(values: Mapping[str, object]) -> list[str]:
    """``--set`` options for values that JSON and TOML write alike."""
    return [word for key, value in values.items() for word in ("--set", f"{key}={json.dumps(value)}")]


@contextmanager
def launched(
    scenario: str, cwd: Path, values: Mapping[str, object], options: Sequence[str] = ()
) -> Iterator[LaunchedRun]:
    """A ``palanquin run`` whose folder is ``cwd/run``."""
    folder = cwd / "run"
    with started("run", scenario, "--out", folder, *settings(values), *options, cwd=cwd) as command:
        yield LaunchedRun(command, folder)


def run_of(story: str, cwd: Path) -> Path:
    """The folder of a scenario, given as text, that was run to its end and left no process over."""
    (cwd / "story.toml").write_text(story)
    with launched("story.toml", cwd, {}) as run:
        run.command.end()
        run.command.look()
        assert run.command.survivors() == []
    return run.folder
