"""What the bench makes of its samples: medians, ratios, files, comparisons; and what it measures with."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from agents.follower import Follower, FollowerSettings
from deploy.bench.carry import CarryFailed
from deploy.bench.comparison import compared
from deploy.bench.figures import RATIO, Figure, NoBenchFile, Part, Samples, as_file, percentile, read_file
from deploy.bench.growth import Cost, straight_line, tick_us, tick_us_apart
from deploy.bench.physics import Carrying
from deploy.bench.plan import team_of
from deploy.bench.process_cost import memory_of
from deploy.bench.rigs import talks_of
from deploy.bench.start_up import EventClock
from deploy.bench.timing import CHUNK, times_us
from sim_server.connections import OVERHEAD, Connections
from sim_server.mujoco_plant import MujocoPlant
from sim_server.tally import Tallies
from sim_server.world import build_world
from wire.codec import encode
from wire.messages import State


def test_a_figure_is_the_median_of_its_turns_and_knows_their_range() -> None:
    samples = Samples()
    for value in (3.0, 1.0, 2.0):
        samples.add("row", "column", "us", value, "less")
        samples.ratio("a / b", "column", 2 * value, value, "more")
    time_us, ratio = samples.figures()
    assert (time_us.value, time_us.low, time_us.high) == (2.0, 1.0, 3.0)
    assert ratio.values == (2.0, 2.0, 2.0)
    assert ratio.unit == RATIO


def test_a_percentile_is_a_value_that_came() -> None:
    values = list(np.random.default_rng(1).permutation(np.arange(1.0, 101.0)))
    assert percentile(values, 50) == 50.0
    assert percentile(values, 99) == 99.0
    assert percentile([7.0], 99) == 7.0


def figure(values: tuple[float, ...], unit: str = RATIO, better: str = "more") -> dict[str, Part]:
    return {"p": Part("p", "P", (Figure("row", "column", unit, values, better),))}  # type: ignore[arg-type]  # any text


@pytest.mark.parametrize(
    ("old", "new", "better", "judged"),
    [
        ((1.0, 1.1), (1.2, 1.3), "more", "better"),
        ((1.0, 1.1), (1.2, 1.3), "less", "worse"),
        ((1.2, 1.3), (1.0, 1.1), "more", "worse"),
        ((1.2, 1.3), (1.0, 1.1), "less", "better"),
        ((1.0, 1.2), (1.1, 1.3), "more", "same"),
        ((1.0, 1.1), (9.0, 9.1), "", None),
    ],
)
def test_a_ratio_has_changed_only_if_the_ranges_do_not_meet(
    old: tuple[float, ...], new: tuple[float, ...], better: str, judged: str | None
) -> None:
    (row,) = compared(figure(old, better=better), figure(new, better=better))
    assert row.judged == judged
    assert row.change == pytest.approx(np.median(new) / np.median(old))


def test_a_time_is_never_judged() -> None:
    (row,) = compared(figure((1.0,), "us", "less"), figure((9.0,), "us", "less"))
    assert row.judged is None


def test_files_without_a_common_figure_cannot_be_compared() -> None:
    with pytest.raises(NoBenchFile, match="no figure in common"):
        compared(figure((1.0,), "us"), figure((1.0,), "ms"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "palanquin-bench/0"}, "format 'palanquin-bench/0', expected"),
        ({"parts": {"p": {"title": "P"}}}, "not whole"),
        ({"parts": []}, "not whole"),
    ],
)
def test_what_is_no_file_of_the_bench_is_refused(change: dict[str, object], said: str, tmp_path: Path) -> None:
    content = as_file({"cores": 2}, {}, figure((1.0, 2.0)).values())
    file = tmp_path / "b.json"
    file.write_text(json.dumps(content))
    assert read_file(file) == ({"cores": 2}, figure((1.0, 2.0)))
    file.write_text(json.dumps(content | change))
    with pytest.raises(NoBenchFile, match=said):
        read_file(file)


def test_a_number_that_is_not_finite_is_no_figure(tmp_path: Path) -> None:
    file = tmp_path / "b.json"
    file.write_text(json.dumps(as_file({}, {}, figure((float("nan"),)).values())))
    with pytest.raises(NoBenchFile, match="all finite"):
        read_file(file)


def test_a_straight_line_is_found_again() -> None:
    a, b = straight_line({N: 200.0 + 150.0 * N for N in (1, 2, 4, 16)})
    assert a == pytest.approx(200.0)
    assert b == pytest.approx(150.0)


def test_the_model_shares_among_the_cores_what_is_not_the_simulators_own() -> None:
    cost = Cost(arms=4, tick=0.0, own=100.0, simulator=150.0, follower=40.0, leader=10.0)
    assert tick_us(cost, 1) == pytest.approx(150.0 + 4 * 40.0 + 10.0)
    assert tick_us(cost, 2) == pytest.approx(100.0 + 110.0)
    assert tick_us(cost, 2, 30.0) == pytest.approx(240.0)
    assert tick_us_apart(cost, 2, 1, 300.0) == pytest.approx(150.0 + 2 * 40.0 + 300.0)
    assert tick_us_apart(cost, 2, 2, 0.0) == tick_us_apart(cost, 2, 9, 0.0) == pytest.approx(150.0 + 40.0)


def test_actions_are_called_in_turns_and_as_often_as_asked() -> None:
    order: list[str] = []
    times = times_us({name: lambda name=name: order.append(name) for name in "ab"}, CHUNK + 10)  # type: ignore[misc]  # cannot infer it
    assert {name: len(each) for name, each in times.items()} == {"a": CHUNK + 10, "b": CHUNK + 10}
    changes = sum(one != other for one, other in pairwise(order))
    assert changes == 5  # a and b are warmed, then a, b, a, b


def test_the_bare_messages_are_as_long_as_those_of_a_run() -> None:
    """Whole numbers in a message are shorter near a run's beginning, by a few bytes."""
    follower = Follower(FollowerSettings("bench", "a1", "panda", "paper", {}))
    reading = MujocoPlant(build_world(team_of(4).load().scenario)).read()["a1"]
    state = State(
        "a1", 5000, 5 * 10**9, reading.q, reading.qd, reading.tau, reading.wrench, reading.grip_m, reading.odometry
    )
    talk = talks_of(["a1"])[0]
    assert abs(talk.asked_bytes - len(encode(state))) <= 8
    assert abs(talk.answered_bytes - len(encode(follower.answer(state, 1, 1e-3)))) <= 8


@pytest.mark.parametrize("count", [1, 2, 3, 16])
def test_every_size_of_team_carries_without_losing_the_load(count: int) -> None:
    carrying = Carrying(count)
    height_m = carrying.plant.load_pose().position[2]
    for _ in range(100):
        carrying.tick()
    assert len(carrying.plant.names) == count
    assert abs(carrying.plant.load_pose().position[2] - height_m) < 0.01  # m; falling for 0.1 s would be 0.05


def test_the_bare_step_leaves_the_plant_as_it_is() -> None:
    """Two plants, one of them with bare steps in between: the same bits."""
    plain, beside = Carrying(2), Carrying(2)
    plain._bare.step = lambda: None  # type: ignore[method-assign]
    for _ in range(50):
        plain.tick()
        beside.tick()
    np.testing.assert_array_equal(plain.plant.world.data.qpos, beside.plant.world.data.qpos)


def test_lines_of_the_events_are_noted_when_they_are_whole(tmp_path: Path) -> None:
    file = tmp_path / "events.jsonl"
    clock = EventClock(file)
    clock.start()
    with file.open("w") as events:
        events.write('{"kind": "started", "tick": 0}\n{"kind": "seen", "agent": "a1"')
        events.flush()
        while not clock.seen:
            pass
        assert [event["kind"] for _, event in clock.seen] == ["started"]
        events.write("}\n")
    clock.stop()
    assert clock.at("seen", agent="a1") > clock.at("started")
    with pytest.raises(CarryFailed, match="told of no 'lost'"):
        clock.at("lost")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells it")
def test_the_memory_of_a_process_is_told_while_it_is_there() -> None:
    own = memory_of(os.getpid())
    assert own is not None
    assert own.pss_MB is None or 1.0 < own.pss_MB <= own.rss_MB
    ended = subprocess.Popen(["true"])
    ended.wait()
    assert memory_of(ended.pid) is None


def test_without_anybody_who_counts_there_is_no_thread_that_watches() -> None:
    before = threading.active_count()
    with Connections(None, Tallies(), OVERHEAD["tcp"]).watching():
        assert threading.active_count() == before
