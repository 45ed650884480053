"""``palanquin watch`` and ``palanquin run --watch`` as real processes in a pseudo terminal."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from processes import PALANQUIN, PATIENCE_S, read_json, started, wait_until
from watched import event, progress, row

from wire.codec import encode
from wire.keys import Keys
from wire.link import Link
from wire.zenoh_link import free_endpoint, open_server

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
SECOND_SCREEN, FIRST_SCREEN, CURSOR = "\x1b[?1049h", "\x1b[?1049l", "\x1b[?25h"
KEYS = Keys("demo")


class Terminal:
    """A command in a pseudo terminal of its own, and all that it wrote there."""

    def __init__(self, process: subprocess.Popen[bytes], master: int) -> None:
        self.process, self._master = process, master
        self._written = bytearray()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while True:
            try:
                part = os.read(self._master, 65536)
            except OSError:  # nobody has the other side open any more
                return
            if not part:
                return
            self._written += part

    def written(self) -> str:
        return bytes(self._written).decode(errors="replace")

    def text(self) -> str:
        """Without colours and movements of the cursor."""
        return ESCAPES.sub("", self.written())

    def wait_for(self, pattern: str) -> None:
        wait_until(
            lambda: re.search(pattern, self.text()) or self.process.poll() is not None, f"{pattern}\n{self.text()}"
        )
        assert re.search(pattern, self.text()), self.text()

    def type(self, keys: bytes) -> None:
        os.write(self._master, keys)

    def end(self) -> int:
        status = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        return status


@contextmanager
def terminal(*arguments: str | Path, cwd: Path, columns: int = 80, lines: int = 24) -> Iterator[Terminal]:
    """A ``palanquin`` command at a terminal of this size."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES", "NO_COLOR")}

    def take_terminal() -> None:
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    process = subprocess.Popen(
        [PALANQUIN, *arguments],
        cwd=cwd,
        env={**environment, "TERM": "xterm-256color"},
        stdin=slave,
        stdout=slave,
        stderr=slave,
        preexec_fn=take_terminal,
    )
    os.close(slave)
    try:
        yield Terminal(process, master)
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(30)
        finally:
            process.kill()
            process.wait(10)
            os.close(master)


def growing_ticks(text: str) -> list[int]:
    return [int(tick) for tick in re.findall(r"tick (\d+) of \d+", text)]


def test_a_run_is_watched_in_its_own_terminal_from_its_first_arm_to_its_verdict(tmp_path: Path) -> None:
    settings = ("--no-picture", "--set", "duration_s=1.5")
    with terminal("run", "hold", "--out", "run", "--watch", *settings, cwd=tmp_path) as seen:
        assert seen.end() == 0, seen.text()
    before, _, rest = seen.written().partition(SECOND_SCREEN)
    picture, _, after = rest.rpartition(FIRST_SCREEN)
    assert ESCAPES.sub("", before).strip() == ""
    shown = ESCAPES.sub("", picture)
    for arm in ("a1", "a2", "a3", "a4"):
        assert re.search(rf"{arm}  +in +0 +\d+ +\d+\.\d +\d+%", shown)
    ticks = growing_ticks(shown)
    assert ticks == sorted(ticks)
    assert len(set(ticks)) > 2
    assert ticks[-1] == 1500
    assert "from above" in shown
    assert "holds: reached its duration" in shown
    assert "verdict: holds" in ESCAPES.sub("", after)
    assert CURSOR in seen.written()
    assert not (tmp_path / "run" / "logs" / "watch.log").exists()  # it had nothing to complain about
    assert read_json(tmp_path / "run" / "audit.json")["verdict"] != "violated"


def test_ctrl_c_at_the_terminal_of_a_watched_run_ends_the_run_and_leaves_the_terminal_in_order(tmp_path: Path) -> None:
    settings = ("--no-picture", "--set", "duration_s=600.0")
    with terminal("run", "hold", "--out", "run", "--watch", *settings, cwd=tmp_path) as seen:
        seen.wait_for(r"tick [1-9]\d* of")
        seen.type(b"\x03")
        assert seen.end() == 3, seen.text()
    picture, _, after = seen.written().rpartition(FIRST_SCREEN)
    assert "stopped by the operator" in ESCAPES.sub("", picture)
    assert "stopped by SIGINT" in ESCAPES.sub("", after)
    assert "Traceback" not in seen.text()


def test_when_a_watched_run_is_killed_its_dashboard_leaves_the_terminal_in_order(tmp_path: Path) -> None:
    settings = ("--no-picture", "--set", "duration_s=600.0")
    with terminal("run", "hold", "--out", "run", "--watch", *settings, cwd=tmp_path) as seen:
        seen.wait_for(r"tick [1-9]\d* of")
        seen.process.kill()
        wait_until(lambda: CURSOR in seen.written().rpartition(FIRST_SCREEN)[0][-20:], "the first screen")


@contextmanager
def simulator() -> Iterator[tuple[Link, str]]:
    """A link that shows a simulator's sign of life, open to all, and its address."""
    endpoint = free_endpoint()
    with open_server(endpoint) as link:
        link.declare_alive(KEYS.sim_alive)
        yield link, endpoint


def tell(link: Link, tick: int, observer: subprocess.Popen[Any]) -> None:
    """What an observer hears of one tick, as soon as it listens."""
    rows, events, reports = map(link.publisher, (KEYS.rows, KEYS.events, KEYS.progress))
    everything = (rows, events, reports)
    wait_until(lambda: observer.poll() is not None or all(each.matched() for each in everything), "an observer")
    assert observer.poll() is None
    rows.put(encode(row(tick, arms=2)))
    reports.put(encode(progress(tick)))


@pytest.mark.parametrize("how", ["ctrl_c", "sigterm", "hangup"])
def test_who_stops_watching_leaves_the_terminal_as_it_was_and_the_run_alone(tmp_path: Path, how: str) -> None:
    with (
        simulator() as (link, endpoint),
        terminal("watch", "--run", "demo", "--connect", endpoint, cwd=tmp_path) as seen,
    ):
        tell(link, 1200, seen.process)
        seen.wait_for(r"tick 1200 of")
        if how == "ctrl_c":
            seen.type(b"\x03")
        else:
            seen.process.send_signal(signal.SIGTERM if how == "sigterm" else signal.SIGHUP)
        assert seen.end() == 0, seen.text()
    after = seen.written().rpartition(FIRST_SCREEN)[2]
    assert CURSOR in after + seen.written().rpartition(FIRST_SCREEN)[0]
    assert "stopped watching at 1.20 s; the run goes on" in ESCAPES.sub("", after)
    assert "a2  there" in ESCAPES.sub("", after)  # the last picture stays


def test_ctrl_c_while_nobody_has_answered_yet_is_one_sentence(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with terminal("watch", "--run", "demo", "--connect", endpoint, "--wait-s", "600", cwd=tmp_path) as seen:
        status = Path(f"/proc/{seen.process.pid}/status")
        # SIGINT has a handler of ours from the moment on that one sentence is promised.
        wait_until(lambda: int(re.findall(r"SigCgt:\s*(\w+)", status.read_text())[0], 16) >> 14 & 1, "it to begin")
        seen.type(b"\x03")
        assert seen.end() == 3
    assert "Traceback" not in seen.text()
    assert seen.text().strip().splitlines()[-1].removeprefix("^C") == "palanquin: stopped by SIGINT"  # the echo


def test_a_simulator_that_goes_away_is_said_to_be_gone(tmp_path: Path) -> None:
    with simulator() as (link, endpoint):
        arguments = ("watch", "--run", "demo", "--connect", endpoint, "--reconnect-s", "0.5")
        with terminal(*arguments, cwd=tmp_path, columns=40) as seen:
            tell(link, 700, seen.process)
            seen.wait_for(r"tick 700 of")
            link.close()
            assert seen.end() == 3, seen.text()
    after = ESCAPES.sub("", seen.written().rpartition(FIRST_SCREEN)[2])
    assert "palanquin: the simulator of run demo is gone" in after
    assert "tick 700" in after


def test_without_a_terminal_there_are_lines_and_the_end_has_the_status_of_the_verdict(tmp_path: Path) -> None:
    with simulator() as (link, at), started("watch", "hold", "--run", "demo", "--connect", at, cwd=tmp_path) as command:
        events = link.publisher(KEYS.events)
        tell(link, 700, command.process)
        command.wait_until(lambda: "tick 700" in command.said(), "a line of progress")
        wait_until(events.matched, "somebody who hears events")
        for each in (event("ended", 900, why="reached its duration"), event("judged", 900, verdict="violated")):
            events.put(encode(each))
        command.wait_until(lambda: "judged" in command.said(), "a line that says the verdict")
        link.close()
        assert command.end() == 1
    assert command.output.read_text().splitlines() == [
        "0.70 s: tick 700 of 10000, tilt 0.25 deg, 1.50 m to the goal",
        "0.90 s: ended: reached its duration",
        "0.90 s: judged: verdict violated",
        "violated: reached its duration",
    ]
    assert command.errors.read_text() == (
        "palanquin: standard output is no terminal: a line for every event and every simulated second\n"
    )
