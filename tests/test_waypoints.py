"""A way by places: on to the next when the load has come near; the same views give the same way."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import read_events, run_of
from refused import refused

from agents.leader import LeaderSettings, LeaderSettingsError, pull, read_waypoint
from agents.waypoints import Place, Waypoints
from deploy.agents_told import leader_arguments
from sim_server.scenario_files import load_scenario
from sim_server.trace import read_trace

WAY: tuple[Place, ...] = ((1.0, 0.0), (1.0, 1.0))
SCENARIO = """
extends = "transport"
description = "Two arms and a light table, pulled forward past a place that is near, then back."
duration_s = 1.5
[team]
count = 2
[load]
mass_kg = 8.0
[leader]
goal_m = [-2.0, 0.0]
waypoints = [[1.0, 0.0]]
near_m = 0.99
[record]
every_ticks = 1
"""


def test_each_place_is_pulled_to_until_the_load_is_near_and_then_the_next() -> None:
    way = Waypoints(WAY, 0.2)
    assert way.next_place(0, (0.0, 0.0)) == (1.0, 0.0)
    assert way.next_place(1, (0.79, 0.0)) == (1.0, 0.0)
    assert way.next_place(2, (0.8, 0.0)) == (1.0, 1.0), "at the radius is near"
    assert way.next_place(3, (0.0, 0.0)) == (1.0, 1.0), "what was reached stays reached"
    assert way.next_place(4, (1.0, 1.0)) is None
    assert way.next_place(5, (0.0, 0.0)) is None


def test_places_that_are_near_already_are_passed_at_one_look() -> None:
    assert Waypoints(((0.0, 0.1), (0.1, 0.0), (3.0, 0.0)), 0.2).next_place(0, (0.0, 0.0)) == (3.0, 0.0)
    assert Waypoints((), 0.2).next_place(0, (0.0, 0.0)) is None


def test_a_simulator_that_goes_on_from_before_finds_the_place_not_reached_yet() -> None:
    way = Waypoints(WAY, 0.2)
    assert way.next_place(10, (0.9, 0.0)) == (1.0, 1.0)
    assert way.next_place(20, (1.0, 0.9)) is None
    assert way.next_place(15, (1.0, 0.5)) == (1.0, 1.0)
    assert way.next_place(9, (0.5, 0.0)) == (1.0, 0.0)
    assert way.next_place(10, (0.9, 0.0)) == (1.0, 1.0)


NUMBERS = st.floats(-3.0, 3.0)
PLACES = st.lists(st.tuples(NUMBERS, NUMBERS), max_size=5).map(tuple)


@given(PLACES, st.lists(st.tuples(NUMBERS, NUMBERS), max_size=20), st.integers(0, 20))
def test_to_go_on_from_any_moment_before_changes_nothing(
    places: tuple[Place, ...], loads: list[Place], again: int
) -> None:
    way = Waypoints(places, 0.5)
    first = [way.next_place(time, load) for time, load in enumerate(loads)]
    resumed = [way.next_place(time, load) for time, load in list(enumerate(loads))[again:]]
    assert resumed == first[again:]
    for aim, load in zip(first, loads, strict=True):
        assert aim is None or math.dist(aim, load) > 0.5


@given(st.tuples(NUMBERS, NUMBERS), st.floats(0.1, 100.0))
def test_a_pull_to_a_place_is_bounded_and_in_the_plane(place: Place, force_max_N: float) -> None:
    from test_leader import view

    force = pull(view(0), np.array([0.8, 0.0, 0.7]), LeaderSettings("test", (2.0, 0.0), force_max_N), place)
    assert np.linalg.norm(force) <= force_max_N
    assert force[2] == 0.0


# What the leader is told


def test_the_leader_is_told_the_scenarios_very_waypoints() -> None:
    places = [[-0.1, 1 / 3], [1e-30, -2.0]]
    told = leader_arguments(load_scenario("transport", {"leader": {"waypoints": places, "near_m": 0.1}}).scenario)
    said = [read_waypoint(word.removeprefix("--waypoint=")) for word in told if "--waypoint" in word]
    assert said == [tuple(place) for place in places]
    assert told[told.index("--near-m") + 1] == "0.1"
    assert "--near-m" not in leader_arguments(load_scenario("transport").scenario)


def test_a_scenario_without_them_is_written_as_before() -> None:
    """Reports know their runs by a digest of the resolved scenario."""
    written = load_scenario("transport").scenario.model_dump(mode="json")["leader"]
    assert not {"waypoints", "near_m", "by"} & written.keys()
    leader = {"waypoints": [[1.0, 0.0]]}
    written = load_scenario("transport", {"leader": leader}).scenario.model_dump(mode="json")["leader"]
    assert (written["waypoints"], written["near_m"], "by" in written) == ([[1.0, 0.0]], 0.15, False)
    written = load_scenario("transport", {"leader": {"by": "keyboard"}}).scenario.model_dump(mode="json")["leader"]
    assert written["by"] == "keyboard"


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,soon", "1 2"])
def test_a_waypoint_that_is_none_is_shown_one(text: str) -> None:
    with pytest.raises(LeaderSettingsError, match="expected X,Y in m, such as"):
        read_waypoint(text)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--goal-m", "2", "0", "--waypoint", "0.8;0"), "waypoint '0.8;0': expected X,Y in m"),
        (("--goal-m", "2", "0", "--waypoint", "0.8,nan"), "waypoint 1: got nan, expected a finite number"),
        (("--goal-m", "2", "0", "--waypoint", "1,0", "--stop", "1,0,3"), "got stops and waypoints"),
        (("--keyboard", "--waypoint", "1,0"), "got a way and a person"),
        (("--keyboard", "--gamepad"), "Got several of --keyboard, --gamepad, --wishes"),
        ((), "where to? Give --goal-m X Y, or let a person lead"),
    ],
)
def test_a_leader_that_cannot_know_where_to_is_refused_in_one_sentence(words: tuple[str, ...], said: str) -> None:
    status, sentence = refused(["leader", "--run", "x", *words])
    assert (status, said in sentence) == (2, True), sentence


@pytest.mark.system
@pytest.mark.timeout(240)
def test_a_run_turns_at_the_very_look_at_which_the_load_has_come_near(tmp_path: Path) -> None:
    trace = read_trace(run_of(SCENARIO, tmp_path) / "trace.parquet")
    force, place = trace["leader.force"], trace["load.position"][:, :2]
    looks = np.arange(0, len(force), 10)  # one a 10 ms, at the pose of the tick before it
    near = np.hypot(*(place[looks - 1] - (1.0, 0.0)).T) <= 0.99
    near[0] = False
    first = int(looks[near.argmax()])
    assert near.any()
    assert (force[:first, 0] > 0.0).all()
    assert (force[first:, 0] < 0.0).all()
    assert np.linalg.norm(force, axis=1).max() <= 40.0


@pytest.mark.system
@pytest.mark.timeout(240)
def test_a_simulator_that_goes_on_from_before_a_waypoint_has_the_load_pulled_there_again(tmp_path: Path) -> None:
    """Reached at 0.30 s, killed at 0.35 s, gone on with from 0.2 s: the same leader's process turns at 0.30 s again."""
    kill = '[[events]]\nat_s = 0.35\nkind = "sim_kill"\n'
    near = SCENARIO.replace("near_m = 0.99", "near_m = 0.95").replace("duration_s = 1.5", "duration_s = 0.5")
    folder = run_of(near + "checkpoint_s = 0.2\n" + kill, tmp_path)
    resumed = [each["tick"] for each in read_events(folder) if each["kind"] == "resumed"]
    force = read_trace(folder / "trace.parquet")["leader.force"][:, 0]
    assert resumed == [200]
    # Its agents take over anew, which moves the load by a hair: a look or two earlier or later.
    assert (force[:280] > 0.0).all()
    assert (force[320:] < 0.0).all()
