"""What is asked of our law, on metrics made by hand: each target is kept, and broken by what it is about."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deploy.paper.ablations import ablation_runs, times_three_runs
from deploy.paper.judging import judge
from deploy.paper.plan import section_vi_runs
from deploy.paper.report import comparison_table
from deploy.paper.results import Results
from deploy.paper.targets import TARGETS
from deploy.planned_run import Run
from sim_server.run_folder import METRICS

GOOD = {"tilt_max_deg": 0.2, "sag_max_mm": 2.0, "yaw_max_deg": 1.0, "overshoot_m": 0.01, "goal_error_m": 0.05}
THEIRS = {**GOOD, "tilt_max_deg": 0.5, "sag_max_mm": 8.0}
RUNS = [*section_vi_runs(range(1, 2)), *times_three_runs(range(1, 2)), *ablation_runs(range(1, 2))]


def results(root: Path, group: str = "", condition: str = "", **changed: float | None) -> Results:
    """All runs, good ones, but for our law's in one place."""
    for run in RUNS:
        numbers: dict[str, float | None] = dict(GOOD if run.law == "palanquin" else THEIRS)
        if run.law == "palanquin" and (run.group, run.condition) == (group, condition):
            numbers |= changed
        folder = root / run.place
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / METRICS).exists() or run.group == group:
            (folder / METRICS).write_text(json.dumps(numbers))
    return Results(root, RUNS)


def verdicts(found: Results) -> dict[str, str]:
    return {claim.name: judge(claim, found, "palanquin").verdict for claim in TARGETS}


def test_a_law_that_keeps_all_targets_holds_them_all(tmp_path: Path) -> None:
    assert set(verdicts(results(tmp_path)).values()) == {"holds"}


@pytest.mark.parametrize(
    ("target", "group", "condition", "metric", "value"),
    [
        ("x3 pushed: half", "x3", "pushed", "tilt_max_deg", 0.26),
        ("x3 pushed: half", "x3", "pushed", "sag_max_mm", 4.1),
        ("x3 failed-grasp: half", "x3", "failed-grasp", "sag_max_mm", 4.1),
        ("overshoot 16", "arms", "16", "overshoot_m", 0.11),
        ("yaw", "VI-C", "failed-grasp", "yaw_max_deg", 6.1),
        ("delay", "delay", "20", "tilt_max_deg", 1.1),
        ("overshoot 8", "arms", "8", "overshoot_m", None),
    ],
)
def test_each_target_is_missed_by_what_it_is_about_and_by_nothing_else(
    target: str, group: str, condition: str, metric: str, value: float | None, tmp_path: Path
) -> None:
    found = verdicts(results(tmp_path, group, condition, **{metric: value}))
    assert {name for name, verdict in found.items() if verdict != "holds"} == {target}


def test_a_seed_whose_run_to_compare_with_is_missing_says_nothing(tmp_path: Path) -> None:
    results(tmp_path)
    found = verdicts(Results(tmp_path, [run for run in RUNS if run.law == "palanquin"]))
    assert {name for name, verdict in found.items() if verdict == "unknown"} == {
        name for name in found if name.startswith("x3")
    }


def test_a_target_without_runs_is_unknown(tmp_path: Path) -> None:
    assert set(verdicts(Results(tmp_path, list[Run]())).values()) == {"unknown"}


def test_the_comparison_marks_what_is_worse(tmp_path: Path) -> None:
    text = comparison_table(results(tmp_path, "VI-C", "twisted", yaw_max_deg=2.0))
    (yaw,) = [line for line in text.splitlines() if line.startswith("| yaw")]
    assert yaw.count("1 / **2**") == 1
    assert "**" not in yaw.replace("1 / **2**", "")
