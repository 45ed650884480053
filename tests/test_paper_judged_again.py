"""A report's verdicts against its numbers, and its numbers against runs made anew, on reports made by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import deploy.paper.judging_again as again
from deploy.batch import BatchError
from deploy.paper.judging_again import MadeAgain, drawn, judged_again, unfounded
from deploy.paper.plan import section_vi_runs
from deploy.planned_run import Run
from sim_server.run_folder import METRICS


def claim(verdict: str, *values: float, name: str = "yaw", bound: str = "<= 6") -> dict[str, Any]:
    seeds = list(range(1, 1 + len(values)))
    return {
        "name": name, "law": "palanquin", "verdict": verdict, "bound": bound, "seeds": seeds, "values": list(values),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("verdict", "values", "bound"),
    [
        ("holds", (5.0, 6.0), "<= 6"),
        ("violated", (5.0, 7.0), "<= 6"),
        ("violated", (2.9,), ">= 3"),
        ("unknown", (1.0, 1.0, 7.0), "<= 6"),
        ("unknown", (), ""),
    ],
)
def test_a_verdict_is_what_its_values_and_its_bound_make_of_it(
    verdict: str, values: tuple[float, ...], bound: str
) -> None:
    assert unfounded({"claims": [claim(verdict, *values, bound=bound)]}) == []
    if values:
        for other in {"holds", "violated", "unknown"} - {verdict}:
            assert unfounded({"claims": [claim(other, *values, bound=bound)]}) == ["yaw, palanquin"]


def report(*claims: dict[str, Any]) -> dict[str, Any]:
    runs = [run for run in section_vi_runs(range(1, 3)) if run.law == "palanquin" and run.condition == "failed-grasp"]
    entries = [
        {
            "name": run.name, "group": run.group, "condition": run.condition, "law": run.law,
            "scenario": run.scenario, "changes": run.changes, "seed": run.seed,
        }
        for run in runs
    ]  # fmt: skip
    return {"runs": entries, "claims": list(claims)}


def test_claims_are_drawn_with_their_seeds_and_the_same_ones_again() -> None:
    content = report(claim("holds", 0.5, 0.6), claim("holds", 1.0, name="of another release"))
    two = drawn(content, 9, 1)
    assert {(each.seed, each.reported) for each in two} == {(1, 0.5), (2, 0.6)}
    assert drawn(content, 1, 4) == drawn(content, 1, 4)


def test_a_claim_is_judged_from_runs_that_are_made_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def run_one(run: Run, folder: str) -> str:
        made.append(run.name)
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / METRICS).write_text(json.dumps({"yaw_max_deg": 0.5 + 1e-9 * run.seed}))
        return ""

    monkeypatch.setattr(again, "run_one", run_one)
    content = report(claim("holds", 0.5, 0.6))
    first, second = sorted(drawn(content, 2, 1), key=lambda each: each.seed)
    runs = MadeAgain(content, tmp_path)
    assert judged_again(first, runs, exact=True) == (False, 0.5 + 1e-9)
    assert judged_again(first, runs, exact=False)[0], "other versions"
    assert not judged_again(second, runs, exact=False)[0]
    assert set(made) == {f"VI-C/failed-grasp/palanquin/seed-{seed}" for seed in (1, 2)}


def test_a_run_that_cannot_be_made_again_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(again, "run_one", lambda run, folder: "no room")
    content = report(claim("holds", 0.5, 0.6))
    with pytest.raises(BatchError, match="no room"):
        judged_again(drawn(content, 1, 1)[0], MadeAgain(content, tmp_path), exact=True)
