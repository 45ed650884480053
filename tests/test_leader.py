"""The leader's way: which stop it pulls to at what time, and never harder than its bound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from processes import read_json, run_of, run_to_end

from agents.leader import LeaderSettings, LeaderSettingsError, Stop, pull
from deploy.agents_told import leader_arguments
from sim_server.scenario import Leader
from sim_server.scenario_files import load_scenario
from sim_server.trace import read_trace
from wire.messages import LeaderView

POINT_O = np.array([0.8, 0.0, 0.7])
WAY = LeaderSettings("test", (2.0, 0.0), stops=(Stop((0.8, 0.0), 8.0), Stop((0.8, 0.5), 12.0)))
SCENARIO = """
extends = "transport"
description = "Two arms and a light table, pulled forward for half a second, then back."
duration_s = 1.0
[team]
count = 2
[load]
mass_kg = 8.0
[leader]
goal_m = [-2.0, 0.0]
stops = [{ goal_m = [1.0, 0.0], until_s = 0.3 }, { goal_m = [-0.5, -1e-3], until_s = 0.505 }]
[record]
every_ticks = 1
"""


def view(time_ns: int, x: float = 0.0, y: float = 0.0, vx: float = 0.0, vy: float = 0.0) -> LeaderView:
    return LeaderView(time_ns // 1_000_000, time_ns, (x, y, 0.0), (1.0, 0.0, 0.0, 0.0), (vx, vy, 0.0), (0.0,) * 3)


@pytest.mark.parametrize(
    ("time_ns", "target"),
    [
        (0, (0.8, 0.0)),
        (7_999_999_999, (0.8, 0.0)),
        (8_000_000_000, (0.8, 0.5)),
        (11_999_999_999, (0.8, 0.5)),
        (12_000_000_000, (2.0, 0.0)),
        (10**12, (2.0, 0.0)),
    ],
)
def test_each_stop_is_pulled_to_until_its_very_time_and_then_the_next(
    time_ns: int, target: tuple[float, float]
) -> None:
    assert WAY.target_m(time_ns) == target
    # At rest at the target nothing pulls; at rest beside it, 0.1 m short in x, 100 N/m pull by 10 N.
    np.testing.assert_array_equal(pull(view(time_ns, *target), POINT_O, WAY), 0.0)
    beside = pull(view(time_ns, target[0] - 0.1, target[1]), POINT_O, WAY)
    np.testing.assert_allclose(beside, [10.0, 0.0, 0.0], atol=1e-12)


def test_without_stops_the_goal_is_pulled_to_from_the_start() -> None:
    assert replace(WAY, stops=()).target_m(0) == (2.0, 0.0)


def test_no_turn_pulls_harder_than_the_bound() -> None:
    rng = np.random.default_rng(1)
    for _ in range(1000):
        around_a_turn = int(rng.choice([8, 12])) * 10**9 + int(rng.integers(-2, 3))
        force = pull(view(around_a_turn, *rng.normal(size=4) * 10 ** rng.uniform(-3, 3)), POINT_O, WAY)
        assert np.linalg.norm(force) <= WAY.force_max_N, "no tolerance: the simulator refuses what is above"


@pytest.mark.parametrize(
    ("stops", "said"),
    [
        ((Stop((0.0, float("nan")), 1.0),), "stop 1: got nan, expected a finite number"),
        ((Stop((0.0, 0.0), 1.0), Stop((0.0, 0.0), float("inf"))), "stop 2: got inf, expected a finite number"),
        ((Stop((0.0, 0.0), 0.0),), "stop 1: until 0 s, expected later than 0 s"),
        ((Stop((0.0, 0.0), 2.0), Stop((1.0, 0.0), 2.0)), "stop 2: until 2 s, expected later than 2 s"),
    ],
)
def test_a_way_that_cannot_be_followed_is_refused(stops: tuple[Stop, ...], said: str) -> None:
    with pytest.raises(LeaderSettingsError, match=said) as caught:
        LeaderSettings("test", (2.0, 0.0), stops=stops)
    assert caught.value.exit_status == 2


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "1,2,soon", "1 2 3"])
def test_a_stop_that_is_no_stop_is_shown_one(text: str) -> None:
    with pytest.raises(LeaderSettingsError, match="expected X,Y,UNTIL_S in m and s"):
        Stop.read(text)


def test_the_leader_is_told_the_scenarios_very_stops() -> None:
    stops = [{"goal_m": [-0.1, 1 / 3], "until_s": 1e-3}, {"goal_m": [1e-30, -2.0], "until_s": 4.0}]
    scenario = load_scenario("transport", {"leader": {"stops": stops}}).scenario
    told = [Stop.read(word.removeprefix("--stop=")) for word in leader_arguments(scenario) if "--stop" in word]
    assert isinstance(scenario.leader, Leader)
    assert [(stop.goal_m, stop.until_s) for stop in told] == [
        (stop.goal_m, stop.until_s) for stop in scenario.leader.stops
    ]
    assert len(told) == 2


@pytest.mark.system
@pytest.mark.parametrize("stop", ["0.8;0;12", "0.8,0,nan", "0.8,0,-1"])
def test_a_bad_stop_by_hand_is_one_sentence(stop: str, tmp_path: Path) -> None:
    ended = run_to_end("leader", "--run", "x", "--goal-m", "2", "0", "--stop", stop, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "stop" in line
    assert ended.returncode == 2


@pytest.mark.system
@pytest.mark.timeout(240)
def test_a_run_is_pulled_from_stop_to_stop_and_judged_by_its_goal(tmp_path: Path) -> None:
    folder = run_of(SCENARIO, tmp_path)
    trace = read_trace(folder / "trace.parquet")
    force, time_s = trace["leader.force"], trace["time_s"]
    assert (force[time_s < 0.2995, 0] > 0.0).all()
    # It looks every 10 ms: at 0.30 s it turns to the second stop, after 0.505 s it looks first at 0.51 s.
    assert (force[time_s > 0.2995, 0] < 0.0).all()
    at = {tick: force[tick] for tick in (509, 510)}
    assert abs(at[509][1] / at[509][0]) > abs(at[510][1] / at[510][0])
    assert np.linalg.norm(force, axis=1).max() <= 40.0
    metrics = read_json(folder / "metrics.json")
    assert metrics["goal_error_m"] == pytest.approx(np.hypot(*(trace["load.position"][-1, :2] - (-2.0, 0.0))))
