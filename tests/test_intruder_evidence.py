"""What decides an intruder's rows that only the simulator saw, how long the run without it lasts, and how it ends."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from deploy.chaos import staged
from deploy.chaos.attempt import Got
from deploy.chaos.comparison import SCENARIO, Comparison
from deploy.chaos.comparison_report import is_closed, status
from deploy.chaos.evidence import settle
from deploy.chaos.intruder import Row
from deploy.exit_status import COULD_NOT_RUN
from sim_server.scenario_files import load_scenario


def is_open(
    folder: Path, reason: str, refused: dict[str, int], *, phase: str = "ticking", missed_ticks: int = 0
) -> bool | None:
    agent = {"phase": phase, "missed_ticks": missed_ticks, "lease": 1, "refused": refused}
    (folder / "run.json").write_text(json.dumps({"agents": {"a1": agent}}))
    (folder / "audit.json").write_text(json.dumps({"verdict": "holds", "why": [], "processes": {}, "counts": []}))
    (settled,) = settle([Row("x", "disturb", Got(None, "sent", refused=reason, sent=100))], folder, "carry", "a1")
    return settled.got.is_open


def test_what_the_simulator_refused_is_closed_if_the_arm_went_on(tmp_path: Path) -> None:
    assert is_open(tmp_path, "stale", {"stale": 100}) is False
    assert is_open(tmp_path, "stale", {"stale": 100}, missed_ticks=1) is True
    assert is_open(tmp_path, "stale", {"stale": 100}, phase="lost") is True


@pytest.mark.parametrize("refused", [{}, {"stale": 0}, {"lease": 100}], ids=str)
def test_what_nobody_refused_was_accepted_in_silence(tmp_path: Path, refused: dict[str, int]) -> None:
    assert is_open(tmp_path, "stale", refused) is True


def test_what_is_too_long_is_dropped_before_the_simulator_can_refuse_it(tmp_path: Path) -> None:
    assert is_open(tmp_path, "length", {}) is False
    assert is_open(tmp_path, "length", {}, missed_ticks=1) is True


@pytest.mark.parametrize(("audit", "expected"), [("holds", 0), ("unknown", 0), ("violated", 1)])
def test_an_audit_that_is_violated_is_enough_to_fail(audit: str, expected: int) -> None:
    comparison = Comparison("passwords", 2, (Row("x", "hear", Got(False, "")),), (), None, 1000, audit)
    assert status(comparison) == expected
    assert is_closed(comparison) is (expected == 0)


@pytest.mark.parametrize("period_ms", [1, 2, 5])
def test_a_run_without_the_intruder_gets_as_many_ticks(period_ms: int) -> None:
    scenario = load_scenario(SCENARIO, {"clock": {"control_period_ms": period_ms}}).scenario
    for ticks in (1, 35, 1001, 2007, 54_321):  # 2007 / 1000 s is a little more than 2007 ticks of 1 ms
        again = scenario.model_copy(update={"duration_s": scenario.seconds(ticks)})
        assert again.ticks == ticks


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("exec sleep 60", "took more than 0.5 s"),  # and says nothing, so that no line wakes who waits for one
        ("exec 0<&-; exit 7", "ended with 7"),  # before it has read its credential
    ],
)
def test_an_intruder_that_hangs_or_dies_is_a_stage_that_failed(
    script: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    false_python = tmp_path / "python"
    false_python.write_text(f"#!/bin/sh\n{script}\n")
    false_python.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(false_python))
    monkeypatch.setattr(staged, "ATTACK_S", 0.5)
    (tmp_path / "logs").mkdir()
    stage = staged.Staged([], load_scenario(SCENARIO).scenario, "tcp/127.0.0.1:1", tmp_path, None)
    with pytest.raises(staged.StageFailed, match=said) as failed:
        stage._tries([], {"proof": "x" * 1_000_000 if "exit" in script else ""}, lambda text: None)
    assert failed.value.exit_status == COULD_NOT_RUN
    stage.end_all()
