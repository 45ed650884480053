"""Scenario files: what ships can run, and what cannot be used says so in one line with file and key."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest
from processes import free_port, run_to_end

from sim_server.errors import ScenarioError
from sim_server.faults.pushes import Push
from sim_server.metrics import METRICS
from sim_server.scenario import Scenario
from sim_server.scenario_files import load_scenario, shipped_names
from sim_server.server import check_world


def written(folder: Path, text: str, name: str = "mine.toml") -> Path:
    """A scenario file; the text's own indentation goes."""
    path = folder / name
    path.write_text(inspect.cleandoc(text))
    return path


# What ships


@pytest.mark.parametrize("name", shipped_names())
def test_a_shipped_scenario_loads_and_its_robots_fit(name: str) -> None:
    named = load_scenario(name)
    assert named.name == name
    assert named.scenario.description
    assert named.scenario.expect
    check_world(named)


def test_the_scenarios_of_the_main_job_ship_with_their_teams_and_loads() -> None:
    found = {name: load_scenario(name).scenario for name in shipped_names()}
    told = {name: (s.team.count, s.load.mass_kg, s.leader is not None) for name, s in found.items()}
    assert (
        told.items()
        >= {
            "hold": (4, 20.0, False),
            "transport": (4, 20.0, True),
            "transport-fixed-stiffness": (4, 20.0, True),
            "transport-six": (6, 45.0, True),
            "transport-one": (1, 2.5, True),
        }.items()
    )
    assert found["transport"].leader is not None
    assert found["transport"].leader.goal_m == (2.0, 0.0)
    assert found["transport"].leader.force_max_N == 40.0


def test_fixed_stiffness_is_the_same_carry_but_for_the_stiffness() -> None:
    adaptive, fixed = (load_scenario(name).scenario.model_dump() for name in ("transport", "transport-fixed-stiffness"))
    assert adaptive["team"]["gains"].get("adaptive", True) is True
    assert fixed["team"]["gains"] == {**adaptive["team"]["gains"], "adaptive": False}
    for each in (adaptive, fixed):
        del each["description"]
        del each["team"]["gains"]
        del each["expect"]["sag_max_mm"]  # the one thing that is expected to differ
    assert adaptive == fixed


def test_the_trajectory_with_fixed_stiffness_is_the_same_but_for_the_stiffness() -> None:
    adaptive, fixed = (load_scenario(name).scenario for name in ("trajectory", "trajectory-fixed-stiffness"))
    assert fixed.team.gains == {**adaptive.team.gains, "adaptive": False}
    same = {"description", "team"}
    assert adaptive.model_dump(exclude=same) == fixed.model_dump(exclude=same)
    assert adaptive.model_dump()["team"] | {"gains": {}} == fixed.model_dump()["team"] | {"gains": {}}
    assert (adaptive.base.fixed, adaptive.leader, adaptive.load.mass_kg) == (True, None, 2.5)


def test_the_pushed_carries_are_the_same_carry_but_for_a_push_of_two_seconds_in_the_plane() -> None:
    plain = load_scenario("transport").scenario
    for name, force, torque in (
        ("transport-pushed", (0.0, 50.0, 0.0), (0.0, 0.0, 0.0)),
        ("transport-pushed-along", (-50.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ("transport-twisted", (0.0, 0.0, 0.0), (0.0, 0.0, 20.0)),
    ):
        pushed = load_scenario(name).scenario
        (event,) = pushed.events
        assert isinstance(event, Push)
        assert (event.arm, event.at_s, event.for_s, event.shape) == ("a2", 3.0, 2.0, "constant")
        assert (event.force_N, event.torque_Nm) == (force, torque)
        same = {"description", "events", "expect"}
        assert pushed.model_dump(exclude=same) == plain.model_dump(exclude=same)


def test_real_time_is_the_same_carry_but_for_the_clock() -> None:
    steps, real = (load_scenario(name).scenario for name in ("transport", "transport-real-time"))
    assert (real.clock.mode, real.clock.control_period_ms) == ("real-time", 4)
    for metric, bound in steps.expect.items():
        assert real.expect[metric] == bound
    assert real.expect["real_time_factor"].min == 0.95
    same = {"clock", "leader", "expect", "description"}
    assert real.model_dump(exclude=same) == steps.model_dump(exclude=same)
    assert real.leader is not None
    assert steps.leader is not None
    assert real.leader.model_dump(exclude={"period_ms"}) == steps.leader.model_dump(exclude={"period_ms"})


# extends, --set


def loaded(path: Path, **changes: Any) -> Scenario:
    return load_scenario(str(path), changes).scenario


def test_extends_changes_only_what_the_file_names(tmp_path: Path) -> None:
    mine = loaded(written(tmp_path, 'extends = "transport"\n[load]\nmass_kg = 30.0'))
    theirs = load_scenario("transport").scenario
    assert mine.load.mass_kg == 30.0
    assert mine == theirs.model_copy(update={"load": theirs.load.model_copy(update={"mass_kg": 30.0})})


def test_extends_goes_over_several_files_and_takes_a_file_beside_before_a_shipped_one(tmp_path: Path) -> None:
    written(tmp_path, 'extends = "transport"\nseed = 7\nduration_s = 3.0', "hold.toml")
    mine = loaded(written(tmp_path, 'extends = "hold"\nduration_s = 4.0'))
    assert (mine.seed, mine.duration_s) == (7, 4.0)
    assert mine.leader is not None  # the shipped `hold` has none


def test_a_bound_is_one_value_and_replaces_the_one_below(tmp_path: Path) -> None:
    mine = loaded(written(tmp_path, 'extends = "transport"\n[expect]\ntilt_max_deg = { min = 0.1 }'))
    assert (mine.expect["tilt_max_deg"].min, mine.expect["tilt_max_deg"].max) == (0.1, None)
    assert mine.expect["sag_max_mm"].max == 12.0


def test_an_empty_table_changes_nothing(tmp_path: Path) -> None:
    mine = loaded(written(tmp_path, 'extends = "transport"\n[leader]\n[team]'))
    assert mine == load_scenario("transport").scenario


def test_changes_of_the_command_line_lie_over_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, 'extends = "transport"\nseed = 7\n[load]\nmass_kg = 30.0')
    mine = loaded(path, seed=9, load={"mass_kg": 31.0})
    assert (mine.seed, mine.load.mass_kg, mine.load.struts) == (9, 31.0, 4)


def test_every_metric_can_be_bounded_by_its_name(tmp_path: Path) -> None:
    bounds = "\n".join(f"{name} = {{ max = 1e9 }}" for name in METRICS)
    mine = loaded(written(tmp_path, f'extends = "transport"\n[expect]\n{bounds}'))
    assert mine.expect.keys() == METRICS.keys()


# What cannot be used


def extending(rest: str) -> str:
    return 'extends = "transport"\n' + inspect.cleandoc(rest)


BAD: dict[str, tuple[str, str, tuple[str, ...]]] = {
    # what: (the file's text, the key that must be named, what else must be said)
    "unknown_key_at_the_top": (extending("colour = 3"), "colour", ("unknown key", "duration_s, clock, team")),
    "unknown_key_in_a_table": (extending("[load]\nmass = 3"), "load.mass", ("unknown key", "mass_kg", "struts")),
    "unknown_key_in_a_table_that_may_be_left_out": (
        extending("[leader]\nspeed = 3"),
        "leader.speed",
        ("unknown key", "goal_m, force_max_N"),
    ),
    "unknown_key_in_a_bound": (
        extending("[expect]\ntilt_max_deg = { maximum = 1 }"),
        "expect.tilt_max_deg.maximum",
        ("unknown key", "one of min, max"),
    ),
    "missing_key": ("description = 'x'\n[team]\ncontroller = 'paper'", "team.count", ("missing",)),
    "negative_mass": (
        extending("[load]\nmass_kg = -20.0"),
        "load.mass_kg",
        ("greater than or equal to 0.001", "-20.0"),
    ),
    "no_mass": (extending("[load]\nmass_kg = 0"), "load.mass_kg", ("greater than or equal to 0.001",)),
    "goal_is_no_number": (extending("[leader]\ngoal_m = [nan, 0.0]"), "leader.goal_m.0", ("finite", "nan")),
    "goal_is_infinite": (extending("[leader]\ngoal_m = [2.0, inf]"), "leader.goal_m.1", ("finite", "inf")),
    "goal_has_three_numbers": (extending("[leader]\ngoal_m = [2.0, 0.0, 0.0]"), "leader.goal_m", ("2 items",)),
    "stop_is_no_number": (
        extending("[leader]\nstops = [{ goal_m = [nan, 0.0], until_s = 1.0 }]"),
        "leader.stops.0.goal_m.0",
        ("finite", "nan"),
    ),
    "stop_at_no_time": (
        extending("[leader]\nstops = [{ goal_m = [1.0, 0.0], until_s = 0.0 }]"),
        "leader.stops.0.until_s",
        ("greater than 0",),
    ),
    "stop_without_an_end": (
        extending("[leader]\nstops = [{ goal_m = [1.0, 0.0] }]"),
        "leader.stops.0.until_s",
        ("missing",),
    ),
    "unknown_key_in_a_stop": (
        extending("[leader]\nstops = [{ goal_m = [1.0, 0.0], until_s = 1.0, force_N = 3.0 }]"),
        "leader.stops.0.force_N",
        ("unknown key", "one of goal_m, until_s"),
    ),
    "stops_out_of_order": (
        extending("[leader]\nstops = [{ goal_m = [1.0, 0.0], until_s = 5.0 }, { goal_m = [1.5, 0.0], until_s = 5.0 }]"),
        "leader.stops.1.until_s",
        ("5 s is not after 5 s",),
    ),
    "stop_beyond_the_end": (
        extending("[leader]\nstops = [{ goal_m = [1.0, 0.0], until_s = 20.0 }]"),
        "leader.stops.0.until_s",
        ("20 s is not before the run's end at 20 s",),
    ),
    "waypoint_is_no_number": (
        extending("[leader]\nwaypoints = [[1.0, inf]]"),
        "leader.waypoints.0.1",
        ("finite", "inf"),
    ),
    "waypoints_and_stops": (
        extending("[leader]\nwaypoints = [[1.0, 0.0]]\nstops = [{ goal_m = [1.0, 0.0], until_s = 5.0 }]"),
        "leader.waypoints",
        ("beside leader.stops", "one of the two"),
    ),
    "no_way_to_be_near": (extending("[leader]\nnear_m = 0.0"), "leader.near_m", ("greater than 0",)),
    "nobody_leads": (extending("[leader]\nby = 'nobody'"), "leader.by", ("'keyboard'", "'nobody'")),
    "a_person_and_a_way": (
        extending("[leader]\nby = 'keyboard'\nwaypoints = [[1.0, 0.0]]"),
        "leader.by",
        ("'keyboard'", "both would lead"),
    ),
    "bound_is_infinite": (extending("[expect]\ntilt_max_deg = { max = inf }"), "expect.tilt_max_deg.max", ("finite",)),
    "bound_without_bounds": (
        "description = 'x'\n[team]\ncount = 4\n[expect]\nyaw_max_deg = {}",
        "expect.yaw_max_deg",
        (),
    ),
    "more_arms_than_struts": (extending("[team]\ncount = 5"), "team.count", ("5 arms", "load.struts = 4")),
    "more_arms_than_there_can_be": (extending("[team]\ncount = 17"), "team.count", ("16", "17")),
    "no_arms": (extending("[team]\ncount = 0"), "team.count", ("1",)),
    "unknown_metric": (
        extending("[expect]\ntilt_max = { max = 1 }"),
        "expect.tilt_max",
        ("unknown metric", "Did you mean tilt_max_deg?", "one of duration_s"),
    ),
    "metric_that_is_not_one_number": (
        extending("[expect]\nload_share = { max = 1 }"),
        "expect.load_share",
        ("unknown metric",),
    ),
    "text_for_a_number": (extending("[team]\ncount = 'four'"), "team.count", ("integer", "'four'")),
    "digits_as_text": (extending("[load]\nmass_kg = '20'"), "load.mass_kg", ("number", "'20'")),
    "true_for_a_number": (extending("[team]\ncount = true"), "team.count", ("integer", "True")),
    "a_part_of_an_arm": (extending("[team]\ncount = 3.0"), "team.count", ("integer",)),
    "number_for_a_table": (extending("load = 20"), "load", ("20",)),
    "wrong_point": (extending("[leader]\npoint = 'middle'"), "leader.point", ("'front'", "'middle'")),
    "wrong_shape": (extending("[load]\nshape = 'ball'"), "load.shape", ("'table'", "'ball'")),
    "unknown_clock": (extending("[clock]\nmode = 'slow'"), "clock.mode", ("'lock-step'", "'slow'")),
    "control_period_between_physics_steps": (
        extending("[clock]\ncontrol_period_ms = 5\n[plant]\nphysics_step_ms = 2"),
        "clock.control_period_ms",
        ("5", "multiple", "plant.physics_step_ms = 2"),
    ),
    "leader_between_ticks": (
        extending("[clock]\ncontrol_period_ms = 4"),
        "leader.period_ms",
        ("10", "multiple", "clock.control_period_ms = 4"),
    ),
    "longer_than_a_day": (extending("duration_s = 1e9"), "duration_s", ("day",)),
    "load_too_small_for_its_robots": (
        extending("[load]\nsize_m = [1.0, 0.5, 0.75]\nstruts = 8"),
        "load.struts",
        ("8 do not fit around 1.0 x 0.5 m", "A load of"),
    ),
    "load_too_high_for_its_robots": (
        extending("[load]\nsize_m = [1.6, 0.9, 1.5]"),
        "load.size_m",
        ("pedestal", "at most 0.8 m"),
    ),
    "fixed_base_and_a_leader_that_pulls_far": (
        extending("[base]\nfixed = true"),
        "leader.goal_m",
        ("2 m", "base.fixed = true", "at most 0.2 m"),
    ),
    "fixed_base_and_a_stop_that_is_far": (
        extending(
            "[base]\nfixed = true\n[leader]\ngoal_m = [0.1, 0.0]\nstops = [{ goal_m = [0.0, 0.3], until_s = 1.0 }]"
        ),
        "leader.goal_m",
        ("0.3 m from the start",),
    ),
    "fixed_base_and_a_waypoint_that_is_far": (
        extending("[base]\nfixed = true\n[leader]\ngoal_m = [0.1, 0.0]\nwaypoints = [[0.0, 0.3]]"),
        "leader.goal_m",
        ("0.3 m from the start",),
    ),
    "fixed_base_and_a_robot_that_comes": (
        "extends = 'hold'\n[base]\nfixed = true\n[team]\ncount = 3\n"
        "[[events]]\nat_s = 5.0\nkind = 'join'\narm = 'a5'\nstrut = 4",
        "events.0.kind",
        ("'join'", "base.fixed = true"),
    ),
    "fixed_is_no_yes_or_no": (extending("[base]\nfixed = 'yes, please'"), "base.fixed", ("boolean",)),
    "block_for_several_hands": (extending("[load]\nshape = 'block'"), "load.struts", ("4", "expected 1")),
    "extends_nobody": ("extends = 'tranport'", "extends", ("'tranport'", "Did you mean transport?")),
    "extends_itself": ("extends = 'mine'", "extends", ("circle",)),
    "extends_itself_by_a_detour": ("extends = './mine'", "extends", ("circle",)),
    "extends_a_number": ("extends = 3", "extends", ("3", "name of a scenario")),
    "not_toml": ("seed = 1\nduration_s 3", "", ("TOML", "line 2")),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_one_line_with_file_and_key(what: str, tmp_path: Path) -> None:
    text, key, said = BAD[what]
    path = written(tmp_path, text)
    with pytest.raises(ScenarioError) as caught:
        check_world(load_scenario(str(path)))
    error = caught.value
    assert (error.file, error.key) == ("mine.toml", key)
    assert str(error).startswith(f"mine.toml: {key}: " if key else "mine.toml: ")
    assert "\n" not in str(error)
    for words in said:
        assert words in str(error)


THROUGH_THE_COMMAND = (
    "unknown_key_in_a_table",
    "negative_mass",
    "goal_is_no_number",
    "goal_is_infinite",
    "more_arms_than_struts",
    "unknown_metric",
    "text_for_a_number",
    "wrong_point",
    "control_period_between_physics_steps",
    "load_too_small_for_its_robots",
    "extends_itself",
    "extends_nobody",
    "not_toml",
)
"""One of each way on which an error comes to the command line; the others differ by the text that was checked above."""


@pytest.mark.system
@pytest.mark.parametrize("what", THROUGH_THE_COMMAND)
def test_bad_input_ends_the_command_with_status_2_and_leaves_nothing_behind(what: str, tmp_path: Path) -> None:
    text, key, said = BAD[what]
    path = written(tmp_path, text)
    ended = run_to_end("run", path, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert line.startswith(f"palanquin: mine.toml: {key}: " if key else "palanquin: mine.toml: ")
    for words in said:
        assert words in line
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert list(tmp_path.rglob("*")) == [path]


@pytest.mark.system
def test_a_gain_that_cannot_be_ends_the_command_with_file_key_got_and_expected(tmp_path: Path) -> None:
    path = written(tmp_path, extending("[team.gains]\nreference = 'cosine'"))
    ended = run_to_end("run", path, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert line.startswith("palanquin: mine.toml: team.gains.reference: Input should be 'none' or 'sine'; got 'cosine'")
    assert ended.returncode == 2
    assert list(tmp_path.rglob("*")) == [path]


@pytest.mark.system
@pytest.mark.parametrize("what", ["unknown_metric", "load_too_small_for_its_robots"])
def test_the_simulator_alone_refuses_bad_input_the_same_way(what: str, tmp_path: Path) -> None:
    path = written(tmp_path, BAD[what][0])
    ended = run_to_end("sim", path, "--listen", f"tcp/127.0.0.1:{free_port()}", cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert line.startswith(f"palanquin: mine.toml: {BAD[what][1]}: ")
    assert ended.returncode == 2
    assert list(tmp_path.rglob("*")) == [path]


@pytest.mark.system
def test_a_scenario_that_is_not_there_is_named_with_the_nearest_that_is(tmp_path: Path) -> None:
    ended = run_to_end("run", "tranport", cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert line.startswith("palanquin: tranport: no scenario of this name and no such file")
    assert "Did you mean transport?" in line
    for name in shipped_names():
        assert name in line
    assert ended.returncode == 2
    assert list(tmp_path.iterdir()) == []


def test_two_files_that_extend_each_other_in_different_folders_are_a_circle(tmp_path: Path) -> None:
    for folder, other in (("a", "b"), ("b", "a")):
        (tmp_path / folder).mkdir()
        written(tmp_path / folder, f'extends = "../{other}/{other}"', f"{folder}.toml")
    with pytest.raises(ScenarioError, match="circle"):
        load_scenario(str(tmp_path / "a" / "a.toml"))


def test_a_file_that_is_not_text_is_refused_like_one_that_is_not_toml(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match=r"mine\.toml: cannot be read as TOML"):
        load_scenario(str(path))


@pytest.mark.system
def test_the_list_of_scenarios_has_a_line_for_each(tmp_path: Path) -> None:
    ended = run_to_end("scenarios", cwd=tmp_path, environment={"COLUMNS": "200"})
    assert ended.returncode == 0
    lines = ended.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(shipped_names())
    for line, name in zip(lines, shipped_names(), strict=True):
        assert load_scenario(name).scenario.description in line


@pytest.mark.parametrize("period_ms", [1, 2, 4])
def test_a_run_has_as_many_ticks_as_its_duration_has_periods(period_ms: int) -> None:
    whole = load_scenario("hold").scenario
    clock = whole.clock.model_copy(update={"control_period_ms": period_ms})
    for ticks in range(1, 20_000, 7):
        last = whole.model_copy(update={"clock": clock, "duration_s": ticks * period_ms / 1000})
        assert last.ticks == ticks
        a_little_more = last.model_copy(update={"duration_s": last.duration_s + 0.3 * period_ms / 1000})
        assert a_little_more.ticks == ticks + 1
