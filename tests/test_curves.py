"""What is plotted of a run is what it says: by hand, by a law, and the same in blocks as in one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from plants import QUIET, plant_of, scenario
from recorded import Array, rows_of, trace_of, write_folder
from refused import refused

from deploy.see.curves import (
    GOAL,
    INTERNAL,
    LATENCY,
    LOAD,
    PULL,
    QUESTIONS,
    SAG,
    SHARE,
    TILT,
    TORQUE,
    TURN,
    Start,
    curves,
)
from deploy.see.happenings import happening, read_happenings
from deploy.see.plots import plot_runs
from sim_server.metrics import TraceFacts, physical_metrics, trace_facts


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Array], TraceFacts, Path]:
    plant = plant_of(scenario(plant=QUIET))
    plant.pull("front", np.array([30.0, 5.0, 0.0]))
    rows = rows_of(plant, 400)
    folder = write_folder(tmp_path_factory.mktemp("curves") / "run", plant, rows)
    return trace_of(plant, rows), trace_facts(json.loads((folder / "run.json").read_text())["facts"]), folder


def test_the_curves_have_the_metrics_as_their_extremes(seen: tuple[dict[str, Array], TraceFacts, Path]) -> None:
    trace, facts, _ = seen
    lines, metrics = curves(trace, facts, Start.of(trace)), physical_metrics(trace, facts)
    assert list(lines) == list(QUESTIONS)
    assert lines[TILT][LOAD].max() == pytest.approx(metrics["tilt_max_deg"])
    assert np.abs(lines[SAG][LOAD]).max() == pytest.approx(metrics["sag_max_mm"])
    assert np.abs(lines[TURN][LOAD]).max() == pytest.approx(metrics["yaw_max_deg"])
    assert lines[GOAL][LOAD][-1] == pytest.approx(metrics["goal_error_m"])
    assert lines[PULL]["leader"].max() == pytest.approx(metrics["leader_force_max_N"]) == pytest.approx(np.hypot(30, 5))
    assert max(line.max() for line in lines[TORQUE].values()) == pytest.approx(
        100 * float(metrics["torque_limit_fraction"])  # type: ignore[arg-type]
    )
    internal = np.stack(list(lines[INTERNAL].values()))
    assert np.sqrt(np.mean(internal**2)) == pytest.approx(metrics["internal_force_rms_N"])
    share = {arm: float(line.mean()) / (20 * 9.81) for arm, line in lines[SHARE].items()}
    assert share == pytest.approx(metrics["load_share"])
    assert all((line == 0).all() for line in lines[LATENCY].values())


def test_blocks_make_the_same_curves_as_the_whole(seen: tuple[dict[str, Array], TraceFacts, Path]) -> None:
    trace, facts, _ = seen
    start, whole = Start.of(trace), curves(trace, facts, Start.of(trace))
    parts = [
        curves({name: column[part] for name, column in trace.items()}, facts, start)
        for part in (slice(0, 1), slice(1, 33), slice(33, None))
    ]
    for question, named in whole.items():
        for name, line in named.items():
            together = np.concatenate([part[question][name] for part in parts])
            np.testing.assert_allclose(together, line, rtol=1e-9, atol=1e-9)  # rounding of batched solves


def test_a_robot_that_is_not_there_has_gaps(seen: tuple[dict[str, Array], TraceFacts, Path]) -> None:
    trace, facts, _ = seen
    gone = {name: column.copy() for name, column in trace.items()}
    for name, column in gone.items():
        if name.startswith("a2."):
            column[10:20] = np.nan
    lines = curves(gone, facts, Start.of(gone))
    for question in (SHARE, INTERNAL, TORQUE):
        np.testing.assert_array_equal(np.isnan(lines[question]["a2"]), np.isin(np.arange(80), np.arange(10, 20)))
        assert np.isfinite(lines[question]["a1"]).all()


def test_events_become_sentences_and_states(seen: tuple[dict[str, Array], TraceFacts, Path]) -> None:
    joined, lost = read_happenings(seen[2] / "events.jsonl")
    assert (joined.text, joined.agent, joined.state, joined.is_trouble) == ("joined a1: lease 1", "a1", "in", False)
    assert (lost.text, lost.state, lost.is_trouble) == ("lost a1: its sign of life is gone, then limp", "lost", True)
    undone = happening({"time_s": 1.0, "kind": "lost", "agent": "a1", "undone": True})
    assert undone.state == ""
    ordered = happening({"time_s": 1.0, "kind": "ordered", "event": "fail_grasp", "agent": "a2"})
    assert (ordered.text, ordered.is_trouble) == ("ordered fail grasp a2", True)


def test_two_runs_are_plotted_beside_each_other(
    seen: tuple[dict[str, Array], TraceFacts, Path], tmp_path: Path
) -> None:
    folders, out = [seen[2], seen[2]], tmp_path / "figures"
    for kind in ("svg", "pdf"):
        made = plot_runs(folders, out, "goal,share,path", kind)
        assert [file.name for file in made] == [f"{name}.{kind}" for name in ("goal", "share", "path")]
    assert len(list(out.iterdir())) == 6
    assert (out / "goal.pdf").read_bytes().startswith(b"%PDF")
    text = (out / "share.svg").read_text()
    for word in ("Who bears how much?", "test, seed 1 (run)", "upward force of each hand [N]", "a4"):
        assert word in text


REFUSED = {
    "no_run": (["nowhere"], "nowhere is no run folder"),
    "question": (["RUN", "--only", "goal,tiltt"], "--only tiltt: expected some of path, goal, tilt"),
    "format": (["RUN", "--format", "bmp"], "--format bmp: expected png, svg, pdf"),
}


@pytest.mark.parametrize(("arguments", "said"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_plotted_is_refused_in_one_sentence(
    seen: tuple[dict[str, Array], TraceFacts, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    status, sentence = refused(["plot", *(seen[2] if word == "RUN" else word for word in arguments)])
    assert status == 2
    assert len(sentence.splitlines()) == 1
    assert said in sentence
    assert not any(tmp_path.iterdir())
