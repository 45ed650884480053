"""A short storm through the real processes, and who is left of a run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from processes import processes_that_name, read_json, run_to_end

from deploy.left_over import left_over
from sim_server.run_folder import LOGS, RUN, read_run
from sim_server.scenario_files import load_scenario

TINY = """
extends = "transport"
description = "Two arms, a light table, no way to go."
duration_s = 2.0
[team]
count = 2
[load]
mass_kg = 8.0
[leader]
goal_m = [0.1, 0.0]
"""


@pytest.mark.system
def test_a_storm_is_drawn_run_and_judged_and_its_file_is_what_ran(tmp_path: Path) -> None:
    (tmp_path / "tiny.toml").write_text(TINY)
    storm = ("chaos", "storm", "--scenario", "tiny.toml", "--seed", "3", "--faults", "2", "--out", "storm")
    only = ("--only", "push-hand", "--only", "stop-continue")
    done = run_to_end(*storm, *only, cwd=tmp_path)
    folder = tmp_path / "storm" / "run"
    judgement = read_json(folder / "chaos.json")
    findings = {finding["invariant"]: finding for finding in judgement["findings"]}
    assert done.returncode == {"holds": 0, "violated": 1, "unknown": 3}[judgement["verdict"]], done.stderr
    assert f"verdict: {judgement['verdict']}" in done.stdout
    # What is known of such a storm: it is too weak to drop anything, and all of it takes effect.
    for name in ("height", "tilt", "torque_limits", "others_carry", "events_complete", "nobody_left"):
        assert findings[name]["verdict"] == "holds", findings[name]
    ran = read_run(folder)["scenario"]
    assert len(ran["events"]) >= 2
    assert load_scenario(str(tmp_path / "storm" / "storm.toml")).scenario.model_dump(mode="json") == ran
    assert processes_that_name(str(folder)) == []


def a_run(folder: Path, pid: int) -> None:
    """As far as it tells who belonged to it."""
    (folder / LOGS).mkdir()
    (folder / LOGS / "sim.log").write_text("INFO first\nrun carry at tcp/127.0.0.1:41229, waiting for a1\n")
    (folder / RUN).write_text(json.dumps({"agents": {"a1": {"pid": pid}, "leader": {"pid": None}}}))


def a_process(proc: Path, pid: int, command: str, session: int, parent: int = 1) -> None:
    (proc / str(pid)).mkdir(parents=True)
    (proc / str(pid) / "cmdline").write_text(command.replace(" ", "\0") + "\0" if command else "")
    (proc / str(pid) / "stat").write_text(f"{pid} (a name) of mine) S {parent} {session} {session} 0 -1\n")


def test_who_names_the_folder_or_the_address_or_is_in_an_agents_session_is_left_over(tmp_path: Path) -> None:
    proc, folder = tmp_path / "proc", tmp_path / "run"
    folder.mkdir()
    (proc / "self").mkdir(parents=True)
    a_run(folder, 77)
    a_process(proc, 10, f"python -m deploy.cli sim --out {folder}", 10)
    a_process(proc, 11, "python -m deploy.cli follower --connect tcp/127.0.0.1:41229", 11)
    a_process(proc, 12, "sleep 1000", 77)
    a_process(proc, 13, "python -m deploy.cli follower --connect tcp/127.0.0.1:4122", 13)
    a_process(proc, 14, f"python -m deploy.cli sim --out {folder}-2", 14)
    a_process(proc, 15, "", 77)  # it has ended, and nobody has asked how
    a_process(proc, 16, f"timeout 100 palanquin chaos run x.toml --out {folder}", 16)
    a_process(proc, 17, f"python -m deploy.cli chaos run x.toml --out {folder}", 16, parent=16)
    a_process(proc, os.getpid(), f"python -m deploy.cli chaos run x.toml --out {folder}", 16, parent=17)
    assert left_over(folder, proc) == [
        "python -m deploy.cli follower --connect tcp/127.0.0.1:41229",
        f"python -m deploy.cli sim --out {folder}",
        "sleep 1000",
    ]


def test_a_process_that_is_there_is_found_and_one_that_has_ended_is_not(tmp_path: Path) -> None:
    a_run(tmp_path, 0)
    command = [sys.executable, "-c", "import sys; sys.stdin.read()", "deploy.cli", str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        assert left_over(tmp_path) == [" ".join(command)]
        process.communicate()
    assert left_over(tmp_path) == []


def test_it_is_not_told_where_it_cannot_be(tmp_path: Path) -> None:
    assert left_over(tmp_path) is None, "no run"
    a_run(tmp_path, 1)
    assert left_over(tmp_path, tmp_path / "no proc") is None
    (tmp_path / LOGS / "sim.log").write_text("it ended at once\n")
    assert left_over(tmp_path) is None


@pytest.mark.system
def test_what_cannot_be_drawn_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    none = run_to_end("chaos", "storm", "--only", "meteor", "--out", "x", cwd=tmp_path)
    full = run_to_end("chaos", "storm", "--only", "leader-kill", "--faults", "3", "--out", "x", cwd=tmp_path)
    assert none.returncode == full.returncode == 2
    assert [path.name for path in tmp_path.iterdir()] == []
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "mine").touch()
    taken = run_to_end("chaos", "storm", "--only-draw", "--out", "x", cwd=tmp_path)
    assert taken.returncode == 2
    assert "x is there already: expected a new or an empty folder" in taken.stderr
    assert "got 'meteor', expected one of " in none.stderr
    assert full.stderr.strip() == (
        "palanquin: --faults 3: there is room for 1 in this storm: expected fewer, or more arms"
    )
    assert [path.name for path in (tmp_path / "x").iterdir()] == ["mine"]
