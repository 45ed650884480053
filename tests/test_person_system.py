"""A person leads a real run from a terminal: the load goes where the keys say, and all ends in order."""

from __future__ import annotations

import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import psutil
import pytest
from processes import PALANQUIN, Started, free_port, read_events, read_json, settings, started, wait_until
from terminals import Terminal, typed_into

from sim_server.trace import read_trace

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

TWO_ARMS = {"team.count": 2, "load.mass_kg": 8.0, "duration_s": 600.0, "record.every_ticks": 1}


def carried_s(terminal: Terminal) -> float:
    """Simulated time that the progress bar shows."""
    times = re.findall(r"([\d.]+) of 600 s", terminal.shown())
    return float(times[-1]) if times else -1.0


def test_a_launched_run_goes_where_the_keys_say_and_tells_that_a_person_led(tmp_path: Path) -> None:
    """Left for a second, then let go, then the person leaves, then Ctrl-C."""
    folder = tmp_path / "run"
    words = ["run", "transport", "--leader", "keyboard", "--no-picture", "--out", str(folder), *settings(TWO_ARMS)]
    with typed_into([str(PALANQUIN), *words], tmp_path) as (terminal, process):
        terminal.wait_for("arrows or W A S D")
        terminal.wait_for("the clock is lock-step")
        terminal.type(b"\x1b[D")
        terminal.wait_for("pull 20 N ←")
        wait_until(lambda: carried_s(terminal) > 1.0, "a second of simulated time")
        terminal.type(b" ")
        terminal.wait_for("let go")
        terminal.type(b"q")
        wait_until(lambda: "left" in [each["kind"] for each in read_events(folder)], "the leader to have left")
        wait_until(lambda: terminal.is_as_before, "the terminal to be as before")
        family = psutil.Process(process.pid).children(recursive=True)
        terminal.type(b"\x03")
        assert process.wait(120) == 3  # it was stopped
        wait_until(lambda: not any(each.is_running() for each in family), "everybody to be gone", 10.0)
        assert terminal.is_as_before
    assert read_json(folder / "run.json")["scenario"]["leader"]["by"] == "keyboard"
    (left,) = [each for each in read_events(folder) if each["kind"] == "left"]
    assert left["agent"] == "leader"
    trace = read_trace(folder / "trace.parquet")
    force, load = trace["leader.force"], trace["load.position"]
    pulled = np.linalg.norm(force, axis=1) > 0.0
    np.testing.assert_allclose(force[pulled], np.tile([0.0, 20.0, 0.0], (pulled.sum(), 1)), atol=1e-12)
    assert pulled.sum() > 500  # of 1000 ticks; how soon the key is seen is the machine's
    assert not pulled[-1]
    assert load[-1, 1] > 0.02
    assert abs(load[-1, 0]) < 0.5 * load[-1, 1]
    walls = (folder / "logs" / "leader.log").read_text()
    assert "walls: " in walls


@contextmanager
def one_arm_waits(cwd: Path) -> Iterator[tuple[Started, list[str]]]:
    """A simulator and a follower that wait for a leader by hand; and what every part is told."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    run = ["--run", "led", "--connect", endpoint]
    place = ["--listen", endpoint, "--open", "--run", "led", "--out", str(cwd / "run")]
    changes = settings({"duration_s": 600.0, "record.every_ticks": 1})
    with (
        started("sim", "transport-one", *place, *changes, cwd=cwd, name="sim") as sim,
        started("follower", "--arm", "a1", *run, cwd=cwd, name="a1"),
    ):
        sim.wait_until(lambda: "waiting for" in sim.said(), "the simulator")
        yield sim, run


def ended_with(sim: Started, kind: str, cwd: Path) -> npt.NDArray[np.float64]:
    """The leader has gone in this way; stop the run when it has gone on without, and give all its pulls."""
    sim.wait_until(lambda: kind in [each["kind"] for each in read_events(cwd / "run")], f"the leader to be {kind}")
    for _ in range(2):  # the first rows that come may be older than the loss
        before = bytes_of_rows(cwd / "run")
        sim.wait_until(lambda before=before: bytes_of_rows(cwd / "run") > before, "more rows")  # type: ignore[misc]
    sim.process.send_signal(signal.SIGINT)
    assert sim.end() == 3
    force: npt.NDArray[np.float64] = read_trace(cwd / "run" / "trace.parquet")["leader.force"]
    np.testing.assert_array_equal(force[-1], 0.0)
    return force


def bytes_of_rows(folder: Path) -> int:
    """Of the trace, as it is written while the run goes on."""
    return sum(part.stat().st_size for part in folder.glob("trace.parts/*.rows"))


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL], ids=["told-to-end", "killed"])
def test_a_leader_by_hand_within_walls_pulls_and_gives_its_terminal_back(end: signal.Signals, tmp_path: Path) -> None:
    with one_arm_waits(tmp_path) as (sim, run):
        command = [str(PALANQUIN), "leader", "--keyboard", "--walls", "--force-max-N", "10", "--point", "centre", *run]
        with typed_into(command, tmp_path) as (terminal, process):
            terminal.wait_for("joined, pulling centre as a person wants, 10 N at most")
            terminal.type(b"x-s")
            terminal.wait_for("pull 4 N ↓")
            assert terminal.gives_each_key
            terminal.type(b"a")
            terminal.wait_for("pull 4 N ←")
            process.send_signal(end)
            process.wait(60)
            wait_until(lambda: terminal.is_as_before, "the terminal to be as before", 20.0)
        force = ended_with(sim, "left" if end == signal.SIGTERM else "lost", tmp_path)
    assert {tuple(np.round(each, 9)) for each in force} <= {(0.0, 0.0, 0.0), (-4.0, 0.0, 0.0), (0.0, 4.0, 0.0)}


def test_a_leader_takes_wishes_as_lines_and_leaves_when_there_are_no_more(tmp_path: Path) -> None:
    with one_arm_waits(tmp_path) as (sim, run):
        command = [str(PALANQUIN), "leader", "--wishes", *run]
        with subprocess.Popen(command, cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            assert process.stdin is not None
            process.stdin.write(b"pull 0 -0.25\n")
            process.stdin.flush()
            sim.wait_until(lambda: "started" in [each["kind"] for each in read_events(tmp_path / "run")], "a tick")
            said, _ = process.communicate(b"not a wish\npull 0 -0.5\n", timeout=60)
        assert (process.returncode, said.splitlines()[-1]) == (0, b"leader: left")
        force = ended_with(sim, "left", tmp_path)
    # Of 10 N, which are all that the scenario allows, though this leader would pull by 40.
    assert {tuple(np.round(each, 9)) for each in force} <= {(0.0, 0.0, 0.0), (0.0, -2.5, 0.0), (0.0, -5.0, 0.0)}
    assert force[:, 1].min() <= -2.5 + 1e-9
