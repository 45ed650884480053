"""Robots that come, with real processes: one by the scenario's word, one because somebody at the keyboard wants it."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import HUNG, launched, not_violated, read_events, read_json, run_to_end

from sim_server.trace import read_trace

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

SCENARIO = """
extends = "hold"
description = "Two arms hold a table by two of four struts; a third and a fourth come; then it is stopped."
duration_s = 120.0
[clock]
control_period_ms = 2
[team]
count = 2
[load]
mass_kg = 8.0
[[events]]
at_s = 0.1
kind = "join"
arm = "a7"
strut = 3
"""


@dataclass
class Seen:
    """What the run left, and what was said to those who asked for robots."""

    folder: Path
    said: str
    events: list[dict[str, Any]]
    ordered: tuple[int, str, str]
    refused: tuple[int, str]
    left_over: list[str]

    def of(self, kind: str, agent: str) -> dict[str, Any]:
        (found,) = [each for each in self.events if each["kind"] == kind and each.get("agent") == agent]
        return found


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    cwd = tmp_path_factory.mktemp("join")
    (cwd / "join.toml").write_text(SCENARIO)
    with launched("join.toml", cwd, {}) as run:
        run.command.wait_until(lambda: run.has("started"), "the start")
        came = run_to_end("join", run.folder, "--strut", "4", cwd=cwd, patience_s=200)
        taken = run_to_end("join", run.folder, "--strut", "1", cwd=cwd)
        run.wait_until_carrying(run.simulated_s() + 1.0)  # its law has taken over
        run.command.process.send_signal(signal.SIGINT)
        run.command.end()
        return Seen(
            run.folder,
            run.command.said(),
            read_events(run.folder),
            (came.returncode, came.stdout, came.stderr),
            (taken.returncode, taken.stderr),
            run.command.survivors(),
        )


def test_a_robot_that_the_scenario_foresees_comes_at_its_tick_and_carries(seen: Seen) -> None:
    assert seen.of("ordered", "a7")["tick"] == seen.of("seen", "a7")["tick"] == 50
    grasped = seen.of("grasped", "a7")
    assert grasped["force_max_N"] < 60.0
    trace = read_trace(seen.folder / "trace.parquet")
    tick, share = trace["tick"], trace["a7.grip"][:, 2]
    assert np.isnan(share[tick < 50]).all()
    assert (share[(tick > 50) & (tick < grasped["closed_at_tick"])] == 0.0).all()
    assert (share[tick > grasped["closed_at_tick"] + 5] != 0.0).all()


def test_newcomers_take_a_part_of_the_weight(seen: Seen) -> None:
    """How much is the law's: a light load makes it soft, and dry friction of 0.2 N m a joint is some newtons."""
    trace = read_trace(seen.folder / "trace.parquet")
    settled = trace["tick"] > seen.of("grasped", "a8")["tick"] + 250
    assert np.count_nonzero(settled) > 10
    shares = {arm: trace[f"{arm}.grip"][settled, 2].mean() for arm in ("a1", "a2", "a7", "a8")}
    assert sum(shares.values()) == pytest.approx(8.0 * 9.81, rel=0.01)
    assert shares["a7"] + shares["a8"] > 0.05 * 8.0 * 9.81


def test_a_robot_that_nobody_foresaw_comes_when_it_is_wanted(seen: Seen) -> None:
    status, said, errors = seen.ordered
    assert (status, errors) == (0, "")
    assert "a8 comes to strut 4" in said
    assert "a8 holds strut 4" in said
    assert seen.of("grasped", "a8")["force_max_N"] < 60.0
    assert seen.of("joined", "a8")["lease"] == 1


def test_a_strut_that_is_held_is_refused_in_one_sentence(seen: Seen) -> None:
    status, errors = seen.refused
    assert status == 2
    (line,) = errors.splitlines()
    assert "strut 1 is held by a1: a newcomer needs a free one" in line


def test_the_load_stays_up_and_the_run_ends_as_any_other(seen: Seen) -> None:
    run, metrics = read_json(seen.folder / "run.json"), read_json(seen.folder / "metrics.json")
    assert run["ended"]["why"] == "stopped by the operator"
    assert {name: agent["phase"] for name, agent in run["agents"].items()} == dict.fromkeys(
        ("a1", "a2", "a7", "a8"), "ticking"
    )
    assert run["facts"]["arms"] == ["a1", "a2", "a7", "a8"]
    assert metrics["grasp_force_max_N"] < 60.0
    assert metrics["tilt_max_deg"] < 1.0
    assert set(metrics["load_share"]) == {"a1", "a2", "a7", "a8"}
    not_violated(read_json(seen.folder / "audit.json"), HUNG)
    assert seen.left_over == []
    assert not (seen.folder / "orders").exists()
    assert list(seen.folder.glob("trace.*part*")) == []


def test_a_folder_without_a_run_takes_no_orders(seen: Seen, tmp_path: Path) -> None:
    for folder in (seen.folder, tmp_path / "nowhere"):
        ended = run_to_end("join", folder, "--strut", "2", cwd=tmp_path)
        assert ended.returncode == 2
        (line,) = ended.stderr.splitlines()
        assert f"{folder}: no run that takes orders" in line
