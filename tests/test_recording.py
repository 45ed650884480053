"""Recordings for the viewer: what comes in live is what is replayed, and all of it is in the file."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import QUIET, plant_of, scenario
from processes import read_json, run_to_end
from recorded import Array, rows_of, trace_of
from refused import refused

from deploy.see.curves import QUESTIONS, TICK, Question, Start, curves
from deploy.see.live import LiveRun, Unfitting
from deploy.see.recording import Recording
from deploy.see.replay import CURVES_HZ, SCENE_HZ
from sim_server.mujoco_plant import MujocoPlant
from sim_server.playback import Motion, Playback, thinned
from sim_server.tally import Tallies
from sim_server.trace import columns
from sim_server.truth import TruthFeed
from wire.codec import decode
from wire.keys import Keys
from wire.memory import Broker
from wire.messages import Event, Row

KEYS = Keys("seen")


class Kept(Recording):
    """A recording that keeps what it is given instead of writing it."""

    def __init__(self) -> None:
        self.times: list[Array] = []
        self.p: list[Array] = []
        self.wrists: list[Array] = []
        self.lines: dict[tuple[str, str], list[Array]] = {}
        self.scenes: list[tuple[str, ...]] = []

    def scene(self, shapes: Any, arms: Sequence[str], *rest: Any, **more: Any) -> None:
        self.scenes.append(tuple(arms))

    def motion(self, bodies: Sequence[str], motion: Motion) -> None:
        self.times.append(motion.time_s)
        self.p.append(motion.p)
        self.wrists.append(motion.forces["a1/wrist"].force)

    def curves(self, time_s: Array, lines: Mapping[Question, Mapping[str, Array]]) -> None:
        for question, named in lines.items():
            for name, line in named.items():
                self.lines.setdefault((question.key, name), []).append(line)


class Listening:
    """The simulator's feed with somebody who listens, in memory."""

    def __init__(self) -> None:
        bus = Broker()
        self.rows: list[Row] = []
        self.payloads: list[bytes] = []
        bus.link().subscribe(KEYS.rows, self._take)
        self.feed = TruthFeed(bus.link(), KEYS, Tallies())

    def _take(self, payload: bytes) -> None:
        self.payloads.append(payload)
        self.rows.append(decode(payload, Row))


@pytest.fixture(scope="module")
def told() -> tuple[MujocoPlant, list[Row], dict[str, Array]]:
    """A plant, the rows that an observer was told of it, and its trace."""
    plant, listening = plant_of(scenario(plant=QUIET)), Listening()
    rows = rows_of(plant, 600)
    for row in rows:
        listening.feed.row(row, 900_000, plant.world.arms)
    listening.feed.close()
    return plant, listening.rows, trace_of(plant, rows)


def test_a_row_is_encoded_only_while_somebody_listens(told: tuple[MujocoPlant, list[Row], dict[str, Array]]) -> None:
    plant, rows, _ = told
    tallies = Tallies()
    feed = TruthFeed(Broker().link(), KEYS, tallies)
    feed.row(rows_of(plant, 1)[0], 1, plant.world.arms)
    feed.event(0, 0.0, "lost", {"agent": "a1"})
    assert [row.messages for row in tallies.rows.values()] == [0, 0]
    assert len(rows) == 120


@settings(max_examples=10)
@given(cuts=st.lists(st.integers(0, 120), max_size=4).map(sorted))
def test_what_comes_in_live_is_recorded_as_what_is_replayed(
    told: tuple[MujocoPlant, list[Row], dict[str, Array]], cuts: list[int]
) -> None:
    """However the rows are cut into blocks: the same poses, forces and curves as from the trace."""
    plant, rows, trace = told
    kept = Kept()
    live = LiveRun(plant.world.scenario, kept)
    for first, last in zip([0, *cuts], [*cuts, len(rows)], strict=True):
        live.rows(rows[first:last])
    playback = Playback(plant.world.scenario, {name: ids.strut for name, ids in plant.world.arms.items()})
    motion = playback.motion(trace, thinned(trace["time_s"], 0.005, SCENE_HZ))
    np.testing.assert_array_equal(np.concatenate(kept.times), motion.time_s)
    np.testing.assert_array_equal(np.concatenate(kept.p), motion.p)
    np.testing.assert_array_equal(np.concatenate(kept.wrists), motion.forces["a1/wrist"].force)
    chosen = thinned(trace["time_s"], 0.005, CURVES_HZ)
    whole = curves(trace, live.facts, Start.of(trace))
    assert list(whole) == list(QUESTIONS)
    for question, named in whole.items():
        for name, line in named.items():
            together = np.concatenate(kept.lines[question.key, name])
            np.testing.assert_allclose(together, line[chosen], rtol=1e-9, atol=1e-9)  # rounding of batched solves
    assert set(np.concatenate(kept.lines[TICK.key, "load"])) == {900.0}


def test_a_robot_that_comes_is_taken_in(told: tuple[MujocoPlant, list[Row], dict[str, Array]]) -> None:
    """Three of the four are in the scenario; the fourth is told with its strut when it is there."""
    plant, rows, _ = told
    three = plant.world.scenario.model_copy(update={"team": plant.world.scenario.team.model_copy(update={"count": 3})})
    kept = Kept()
    LiveRun(three, kept).rows(rows)
    assert kept.scenes == [("a1", "a2", "a3"), ("a1", "a2", "a3", "a4")]
    assert np.isfinite(np.concatenate(kept.p)).all()


def test_rows_of_another_scenario_are_refused_with_what_to_do(
    told: tuple[MujocoPlant, list[Row], dict[str, Array]],
) -> None:
    plant, rows, _ = told
    short = Row(0, 1, rows[0].arms, rows[0].struts, rows[0].values[:-8])
    width = sum(columns(rows[0].arms.split(), 7).values()) - 2
    said = f"rows of {width - 1} numbers came, expected {width} of 4 arms panda: record with the scenario"
    with pytest.raises(Unfitting, match=said):
        LiveRun(plant.world.scenario, Kept()).rows([short])


# Real processes

FOUR = ("--no-picture", "--set", "duration_s=0.6")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four arms hold a table for 0.6 s, and an observer records it."""
    cwd = tmp_path_factory.mktemp("recorded")
    done = run_to_end("run", "hold", "--out", "run", "--record", *FOUR, cwd=cwd)
    assert (cwd / "run" / "run.rrd").exists(), done.stderr + done.stdout
    return cwd / "run"


def chunks(file: Path) -> dict[str, Any]:
    """What Rerun itself reads in a recording: by entity, the rows of its data over time."""
    from rerun.chunk import RrdReader

    found: dict[str, Any] = {}
    for chunk in RrdReader(str(file)).stream():
        if not chunk.is_static:
            found.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
    return found


def times_s(batches: Sequence[Any]) -> list[float]:
    """Simulated times of an entity's rows, in order."""
    return sorted(1e-9 * int(value.value) for batch in batches for value in batch.column("sim_time"))


@pytest.mark.system
def test_a_run_is_recorded_from_its_first_row_to_its_last_by_an_observer(recorded: Path) -> None:
    assert "120 rows recorded, 0 lost, 0 refused" in (recorded / "logs" / "recorder.log").read_text()
    found = chunks(recorded / "run.rrd")
    every = [k / 30 for k in range(18)]
    for entity in ("/scene/load", "/scene/a1/link7", "/scene/a4/base", "/forces/a2/wrist"):
        np.testing.assert_allclose(times_s(found[entity]), every, rtol=0, atol=0.005)  # the row at or after each
    for entity in ("/plots/tilt/load", "/plots/stiffness/a3", "/plots/share/a1", "/plots/tick/load"):
        np.testing.assert_allclose(times_s(found[entity]), np.arange(30) / 50, rtol=0, atol=1e-6)
    assert times_s(found["/events/joined"]) == [0.0] * 4
    assert times_s(found["/events/ended"]) == pytest.approx([0.6])
    assert not (recorded / "run.rrd.part").exists()


@pytest.mark.system
def test_a_recorded_run_is_audited_and_has_the_same_trace_as_one_that_is_not(recorded: Path, tmp_path: Path) -> None:
    assert read_json(recorded / "audit.json")["verdict"] == "holds"
    run_to_end("run", "hold", "--out", "run", *FOUR, cwd=tmp_path)
    assert not (tmp_path / "run" / "run.rrd").exists()
    assert (tmp_path / "run" / "trace.parquet").read_bytes() == (recorded / "trace.parquet").read_bytes()


@pytest.mark.system
def test_a_replay_of_the_trace_is_the_recording_but_for_what_no_file_has(recorded: Path, tmp_path: Path) -> None:
    done = run_to_end("view", recorded, "--save", "replay.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    live, replayed = chunks(recorded / "run.rrd"), chunks(tmp_path / "replay.rrd")
    assert set(live) - set(replayed) == {"/plots/tick/load", "/events/judged"}
    assert set(replayed) <= set(live)
    for entity in ("/scene/a2/link4", "/forces/a3/wrist", "/plots/internal/a1", "/events/joined", "/paths/load"):
        assert times_s(live[entity]) == times_s(replayed[entity])
    p = [
        np.concatenate([np.asarray(batch.column("Transform3D:translation").flatten().flatten()) for batch in found])
        for found in (live["/scene/a2/link4"], replayed["/scene/a2/link4"])
    ]
    np.testing.assert_array_equal(p[0], p[1])


@pytest.mark.system
def test_where_there_is_no_screen_the_viewer_is_not_started_and_it_is_said_what_to_do(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for verb in (["view", str(recorded)], ["run", "hold", "--view", "--out", "run"]):
        status, sentence = refused(verb)
        assert status == 3
        assert len(sentence.splitlines()) == 1
        assert "there is no screen for the viewer" in sentence
    assert not any(tmp_path.iterdir())


REFUSED = {
    "where": (["record", "hold", "--run", "x"], 2, "where to? Give --save FILE, --view, or --viewer URL"),
    "folder": (["record", "hold", "--run", "x", "--save", "no/run.rrd"], 2, "--save no/run.rrd: there is no folder"),
    "scenario": (["record", "holdd", "--run", "x", "--save", "run.rrd"], 2, "holdd"),
    "no_run": (["view", "nowhere", "--save", "run.rrd"], 2, "nowhere is no run folder"),
}


@pytest.mark.parametrize(("arguments", "status", "said"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_recorded_is_refused_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], status: int, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    got, sentence = refused(arguments)
    assert got == status
    assert len(sentence.splitlines()) == 1
    assert said in sentence
    assert not any(tmp_path.iterdir())


def test_an_event_that_an_observer_is_told_is_the_line_of_the_events_file() -> None:
    bus = Broker()
    heard: list[bytes] = []
    bus.link().subscribe(KEYS.events, heard.append)
    feed = TruthFeed(bus.link(), KEYS, Tallies())
    feed.event(12, 0.012, "lost", {"agent": "a1", "why": "gone"})
    feed.close()
    assert [decode(payload, Event) for payload in heard] == [Event(12, 0.012, "lost", '{"agent": "a1", "why": "gone"}')]
