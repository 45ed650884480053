"""The report's runs: what they are, that none is run twice, and that a report can be checked by running it again."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from deploy.batch import Done, is_there, run_missing
from deploy.cli import app
from deploy.paper.ablations import ABLATIONS, ablation_runs, times_three_runs
from deploy.paper.plan import section_vi_runs
from deploy.paper.verifying import (
    REPORT,
    ReportError,
    differences,
    physical,
    read_report,
    run_of,
    sample,
    sha256_of,
    spoiled,
)
from deploy.planned_run import Run, merged
from deploy.settings import scenario_changes
from sim_server.run_folder import EVENTS, METRICS, RUN, TRACE
from sim_server.scenario_files import load_scenario


def run(seed: int = 1, **changes: Any) -> Run:
    return Run("VI-C", "undisturbed", "paper", "transport", changes, seed)


def leave(root: Path, done: Run, **changed: Any) -> None:
    """What a run leaves, as far as the batch looks at it."""
    folder = root / done.place
    folder.mkdir(parents=True)
    about = {"scenario": done.resolved(), "ended": {"completed": True}} | changed
    (folder / RUN).write_text(json.dumps(about))
    (folder / METRICS).write_text("{}")
    (folder / TRACE).touch()
    (folder / EVENTS).write_text(json.dumps({"kind": "started"}) + "\n")


def planned() -> list[Run]:
    return [*section_vi_runs(range(1, 2)), *times_three_runs(range(1, 2)), *ablation_runs(range(1, 2))]


class Written:
    """An engine that leaves what it is told to, and remembers what it was asked for."""

    def __init__(self, problems: Sequence[str] = ()) -> None:
        self.asked: list[str] = []
        self._problems = problems

    def run_all(self, runs: Sequence[Run], root: Path) -> Iterator[Done]:
        for each in runs:
            self.asked.append(each.name)
            problem = "it broke" if each.place in self._problems else ""
            if not problem:
                leave(root, each)
            yield Done(each, problem)


@pytest.mark.parametrize("each", planned(), ids=lambda run: run.name)
def test_every_planned_run_is_a_scenario_and_its_settings_say_the_same_as_its_changes(each: Run) -> None:
    changes = scenario_changes(each.seed, each.settings())
    assert load_scenario(each.scenario, changes).scenario.model_dump(mode="json") == each.resolved()


def test_every_planned_law_takes_the_gains_that_it_is_planned_with() -> None:
    teams = {json.dumps([each.resolved()["team"][key] for key in ("arm", "controller", "gains")]) for each in planned()}
    for arm, controller, gains in map(json.loads, sorted(teams)):
        make_controller(controller, ArmModel(arm), gains)


def test_what_is_the_same_run_lies_in_the_same_folder_and_nothing_else_does() -> None:
    planned_runs = [*section_vi_runs(range(1, 4)), *times_three_runs(range(1, 4)), *ablation_runs(range(1, 4))]
    assert len({each.name for each in planned_runs}) == len(planned_runs)
    places: dict[str, str] = {}
    for each in planned_runs:
        assert places.setdefault(each.place, each.digest) == each.digest
    assert len(places) == len(set(places.values())) < len(planned_runs)
    assert len({ablation.name for ablation in ABLATIONS}) == len(ABLATIONS)


def test_the_unchanged_value_of_an_ablation_is_the_carry_that_it_changes() -> None:
    (undisturbed,) = [each for each in section_vi_runs(range(1, 2), ["paper"]) if each.condition == "undisturbed"]
    same = {each.name for each in ablation_runs(range(1, 2), ["paper"]) if each.place == undisturbed.place}
    assert same >= {f"{name}/paper/seed-1" for name in ("alpha/0.02", "delay/0", "rate/1000", "arms/4", "terms/all")}


def test_what_two_experiments_ask_for_is_run_once(tmp_path: Path) -> None:
    there = run(1)
    engine, counts = Written(), list[tuple[int, int]]()
    runs = [there, Run("delay", "0", "paper", "transport", {}, 1)]
    run_missing(runs, tmp_path, engine, lambda *count: counts.append(count))
    assert engine.asked == [there.name]
    assert counts == [(0, 1), (1, 1)]


def test_a_run_is_its_scenario_changes_and_seed() -> None:
    assert run(1).digest == run(1).digest
    assert run(1).digest != run(2).digest
    assert run(1).digest != run(1, load={"mass_kg": 21.0}).digest


def test_tables_are_laid_over_each_other_without_changing_the_ones_below() -> None:
    below = {"team": {"count": 4, "gains": {"alpha": 1.0}}}
    assert merged(below, {"team": {"gains": {"beta": 2.0}}}) == {
        "team": {"count": 4, "gains": {"alpha": 1.0, "beta": 2.0}}
    }
    assert below == {"team": {"count": 4, "gains": {"alpha": 1.0}}}


def test_what_is_there_is_not_run_again_and_what_failed_is(tmp_path: Path) -> None:
    runs = [run(1), run(2), run(3)]
    first = Written(problems=[runs[1].place])
    counts: list[tuple[int, int]] = []
    problems = run_missing(runs, tmp_path, first, lambda there, total: counts.append((there, total)))
    assert first.asked == [each.name for each in runs]
    assert problems == {runs[1].place: "it broke"}
    assert counts == [(0, 3), (1, 3), (2, 3), (3, 3)]
    second = Written()
    assert run_missing(runs, tmp_path, second, lambda *_: None) == {}
    assert second.asked == [runs[1].name]


def test_another_run_in_the_same_place_or_half_of_one_is_not_taken_for_it(tmp_path: Path) -> None:
    spoiled: list[dict[str, Any]] = [{"scenario": run(2).resolved()}, {"ended": {"completed": False}}, {"ended": 3}]
    for number, changed in enumerate(spoiled):
        root = tmp_path / str(number)
        leave(root, run(1), **changed)
        assert not is_there(run(1), root)
    root = tmp_path / "whole"
    leave(root, run(1))
    assert is_there(run(1), root)
    with (root / run(1).place / EVENTS).open("a") as events:
        print(json.dumps({"kind": "lost", "agent": "a2", "why": "it hung"}), file=events)
    assert not is_there(run(1), root), "a run that lost somebody is not the one that was asked for"
    leave(tmp_path / "again", run(1))
    root = tmp_path / "again"
    assert is_there(run(1), root)
    (root / run(1).place / TRACE).unlink()
    assert not is_there(run(1), root)


def entry(**metrics: Any) -> dict[str, Any]:
    each = run(1)
    return {
        "name": each.name, "group": each.group, "condition": each.condition, "law": each.law,
        "scenario": each.scenario, "changes": dict(each.changes), "seed": each.seed,
        "metrics": {"verdict": "holds", "tilt_max_deg": 0.2, "wall_s": 10.0} | metrics,
    }  # fmt: skip


def test_verifying_sees_one_bit_with_the_same_versions_and_a_part_in_a_thousand_with_others() -> None:
    values = (0.2, 0.2 + 1e-9, 0.3)
    same, close, far = ({"tilt_max_deg": value, "wall_s": 99.0, "verdict": "holds"} for value in values)
    assert differences(entry(), same, exact=True) == [], "wall times are no physics"
    assert [each.metric for each in differences(entry(), close, exact=True)] == ["tilt_max_deg"]
    assert differences(entry(), close, exact=False) == []
    assert [each.metric for each in differences(entry(), far, exact=False)] == ["tilt_max_deg"]
    gone = {"verdict": "violated"}
    assert [each.metric for each in differences(entry(), gone, exact=False)] == ["tilt_max_deg", "verdict"]


def test_a_reports_entry_is_the_run_that_it_was_made_of() -> None:
    assert run_of(json.loads(json.dumps(entry()))).digest == run(1).digest


def test_a_sample_repeats_with_its_seed_and_takes_no_run_twice() -> None:
    report = {"runs": [entry() | {"name": str(k)} for k in range(10)]}
    names = [each["name"] for each in sample(report, 4, 1)]
    assert names == [each["name"] for each in sample(report, 4, 1)]
    assert len(set(names)) == 4
    assert len(sample(report, 99, 1)) == 10


@pytest.mark.parametrize("content", ["", "{}", '{"runs": []}', '{"runs": [{"name": "x"}]}'])
def test_what_is_no_report_is_refused_in_one_sentence(content: str, tmp_path: Path) -> None:
    file = tmp_path / REPORT
    file.write_text(content)
    with pytest.raises(ReportError, match="report"):
        read_report(tmp_path)


def test_a_report_without_versions_or_of_an_unknown_scenario_is_none(tmp_path: Path) -> None:
    whole: dict[str, Any] = {"versions": {}, "runs": [entry()], "claims": []}
    (tmp_path / REPORT).write_text(json.dumps(whole))
    assert read_report(tmp_path)["runs"]
    spoiled_ones = [{"runs": whole["runs"]}, {**whole, "versions": []}]
    spoiled_ones += [{**whole, "runs": [entry() | {"scenario": "nowhere"}]}]
    spoiled_ones += [{**whole, "runs": [entry() | {"changes": {"load": {"mass_kg": -1.0}}}]}]
    claim = {"name": "yaw", "law": "palanquin", "verdict": "holds", "bound": "<= 6", "seeds": [1, 2], "values": [0.5]}
    spoiled_ones += [{**whole, "claims": [claim]}, {**whole, "claims": [{}]}]
    for each in spoiled_ones:
        (tmp_path / REPORT).write_text(json.dumps(each))
        with pytest.raises(ReportError, match="is no report"):
            read_report(tmp_path)


def test_an_entry_that_was_changed_by_hand_is_told() -> None:
    metrics = physical({"verdict": "holds", "tilt_max_deg": 0.2})
    good = entry() | {"digest": run(1).digest, "metrics": metrics, "metrics_sha256": sha256_of(metrics)}
    assert spoiled({"runs": [good]}) == []
    for changed in ({"digest": "0"}, {"seed": 2}, {"metrics": metrics | {"tilt_max_deg": 0.1}}, {"scenario": "hold"}):
        assert spoiled({"runs": [good | changed]}) == [good["name"]], changed


def test_a_place_where_no_report_can_be_written_is_told_before_any_run(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    engine_runs = tmp_path / "runs"
    outcome = CliRunner().invoke(app, ["paper", "--short", "--runs", str(engine_runs), "--out", str(tmp_path / "file")])
    assert outcome.exit_code == 2
    assert "no report can be written there" in outcome.output
    assert not engine_runs.exists()


def test_a_missing_report_is_named(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match="no such file"):
        read_report(tmp_path / "nowhere.json")
