"""Every part of the bench, briefly: its figures are numbers that can be, and stand in its file. No time is judged."""

from __future__ import annotations

import json
import math
import socket
from pathlib import Path

import pytest
from processes import run_to_end

from deploy.bench.figures import FORMAT, RATIO, Part, as_file, read_file
from deploy.bench.lock_step import PEER
from deploy.bench.machine import describe_machine
from deploy.bench.memory import NO_PROC
from deploy.bench.parts import PARTS, run_parts
from deploy.bench.plan import QUICK
from deploy.bench.rigs import NO_PEER, has_peer
from deploy.bench.watching import NO_RECORDER, can_record
from sim_server.run_folder import write_json

ROWS = {
    "controller": {"step as shipped, p50", "numpy alone, p99", "Pinocchio's terms, p50"},
    "physics": {"plant step, p50", "mj_step, p99", "plant step / mj_step"},
    "lock-step": {"Palanquin", "bare Zenoh", "raw Unix sockets", "Palanquin / bare Zenoh"},
    "growth": {"ticks/s times arms", "one tick", "line / measured"},
    "real-time": {"missed", "commands in time", "oldest command", "late, p99", "simulated time / wall time"},
    "start-up": {"to the first tick", "join to first command", "a follower's imports"},
    "memory": {"simulator, RSS", "a follower, RSS", "all processes, RSS"},
    "watching": {"audited, not recorded", "neither", "audited / not"},
}
"""Some that every part has, on every machine that tells them."""
ALONE = ("controller", "physics")
"""Those that start no other process."""


def quick(name: str) -> Part:
    (part,) = run_parts([name], QUICK, lambda what: None)
    return part


def check(part: Part, folder: Path) -> None:
    """Every figure is finite, and positive where it has to be; the file says the same as the part."""
    assert len({(figure.row, figure.column, figure.unit) for figure in part.figures}) == len(part.figures)
    for figure in part.figures:
        assert all(math.isfinite(value) for value in figure.values), figure
        assert not figure.positive or figure.low > 0, figure
        assert figure.unit in (RATIO, "ticks/s", "us", "s", "MB", "%", "ticks", "arms"), figure
    file = folder / "bench.json"
    write_json(file, as_file(describe_machine(), QUICK.as_fields(), [part]))
    assert read_file(file)[1] == {part.name: part}


@pytest.mark.parametrize("name", ALONE)
def test_a_part_in_this_process_gives_its_figures(name: str, tmp_path: Path) -> None:
    part = quick(name)
    check(part, tmp_path)
    assert {figure.row for figure in part.figures} >= ROWS[name]


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", [name for name in PARTS if name not in ALONE])
def test_a_part_with_processes_gives_its_figures(name: str, tmp_path: Path) -> None:
    part = quick(name)
    check(part, tmp_path)
    rows = {figure.row for figure in part.figures}
    assert rows >= ROWS[name] or NO_PROC in part.said
    if name == "lock-step":
        assert (PEER in rows) == has_peer() == (NO_PEER not in part.said)
    if name in ("lock-step", "watching"):
        assert any("recorded" in row and "/" in row for row in rows) == can_record() == (NO_RECORDER not in part.said)


def test_every_part_has_rows_that_are_looked_for() -> None:
    assert ROWS.keys() == PARTS.keys()


def test_the_command_writes_a_file_that_compares_with_itself(tmp_path: Path) -> None:
    done = run_to_end("bench", "controller", "--quick", "--turns", "2", "--out", "b.json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "One step of a law" in done.stdout
    content = json.loads((tmp_path / "b.json").read_text())
    assert content["format"] == FORMAT
    assert content["parts"].keys() == {"controller"}
    assert content["settings"]["turns"] == 2
    machine = content["machine"]
    assert machine["cores"] >= 1
    assert machine["python"].keys() >= {"version", "optimised", "profile_guided", "link_time"}
    assert machine["versions"].keys() >= {"palanquin", "mujoco", "eclipse-zenoh", "pin", "commit"}
    assert socket.gethostname() not in machine.values()
    assert str(Path.cwd()) not in json.dumps(content)
    done = run_to_end("bench", "--compare", "b.json", "b.json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "same" in done.stdout
    assert "worse " not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("physic",), "physic: expected one of controller, physics"),
        (("real-time", "--rate", "300"), "--rate 300: expected one of 250, 500, 1000"),
        (("--arms", "17"), "should be less than or equal to 16"),
        (("controller", "--out", "nowhere/b.json"), "nowhere/b.json: no file can be written there"),
        (("controller", "--out", "."), "a folder, expected the name of a file"),
        (("--compare", "none.json", "none.json"), "none.json cannot be read"),
        (("--compare", "run.json", "run.json"), "run.json: format None, expected"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_bad_input_is_one_clear_error(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text("{}")
    done = run_to_end("bench", *arguments, cwd=tmp_path, environment={"COLUMNS": "400"})
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
