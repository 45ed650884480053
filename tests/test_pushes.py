"""Pushes: what they do to a body by Newton's law, how they go over time, and that they go on wherever a run goes on."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from plants import NO_STIFFNESS, plant_of, scenario
from processes import read_events
from test_resume import KILLED_AT, begin, drive, go_on

from sim_server.faults.pushes import Push
from sim_server.loads import load_body
from sim_server.mujoco_plant import MujocoPlant
from sim_server.push_shapes import FADE_S, SINES, smooth, wave_of
from sim_server.snapshot import pack, unpack
from sim_server.trace import read_trace
from sim_server.world import build_world

Array = NDArray[np.float64]

FOR_S = 0.02
"""Time of a push on a load in free fall: it is 0.1 m above the floor."""


def push(**keys: Any) -> Push:
    return Push.model_validate({"at_s": 0.0, "kind": "push", "for_s": FOR_S, **keys})


def let_fall() -> MujocoPlant:
    """A table that no hand holds any more."""
    plant = plant_of(scenario())
    for arm in plant.names:
        plant.open_hand(arm)
    return plant


def step(plant: MujocoPlant, ticks: int) -> None:
    for _ in range(ticks):
        plant.step()


def momentum(plant: MujocoPlant) -> tuple[Array, Array]:
    """Of the load: linear (3,), and angular about its centre of mass, (3,), world."""
    world, pose = plant.world, plant.load_pose()
    R_WO = plant.world.data.xmat[world.load_body].reshape(3, 3)
    r = R_WO @ world.load_com
    linear = world.load_mass * (pose.linear_velocity + np.cross(pose.angular_velocity, r))
    I_W = R_WO @ load_body(world.scenario.load).inertia.I @ R_WO.T
    return linear, I_W @ pose.angular_velocity


# What it does


@pytest.mark.parametrize("force", [(50.0, 0.0, 0.0), (-7.0, 30.0, 12.0)])
def test_the_impulse_of_a_push_on_a_free_load_is_the_change_of_its_momentum(force: tuple[float, ...]) -> None:
    plant = let_fall()
    plant.push(push(point="centre_of_mass", force_N=force))
    step(plant, 40)  # it acts in the first 20 ms; the rest is free fall
    linear, angular = momentum(plant)
    fall = plant.world.load_mass * plant.world.model.opt.gravity * 0.040
    np.testing.assert_allclose(linear - fall, np.array(force) * FOR_S, rtol=0, atol=1e-9)
    np.testing.assert_allclose(angular, np.zeros(3), rtol=0, atol=1e-9)


@pytest.mark.parametrize("torque", [(0.0, 0.0, 5.0), (4.0, -3.0, 2.0)])
def test_the_impulse_of_a_torque_is_the_change_of_angular_momentum(torque: tuple[float, ...]) -> None:
    plant = let_fall()
    plant.push(push(point="centre_of_mass", torque_Nm=torque))
    step(plant, 20)
    # The load turns by 1e-3 rad meanwhile, and the inertia in the world's axes with it.
    np.testing.assert_allclose(momentum(plant)[1], np.array(torque) * FOR_S, rtol=2e-3, atol=1e-4)


def test_a_push_beside_the_centre_of_mass_turns_the_load_by_its_lever() -> None:
    plant = let_fall()
    force = np.array([0.0, 20.0, 0.0])
    plant.push(push(point="front", force_N=force.tolist()))
    step(plant, 20)
    lever = plant.world.load_points["front"] - plant.world.load_com
    linear, angular = momentum(plant)
    np.testing.assert_allclose(linear[:2], force[:2] * FOR_S, rtol=0, atol=1e-5)  # it turns meanwhile
    np.testing.assert_allclose(angular, np.cross(lever, force) * FOR_S, rtol=2e-3, atol=1e-4)


def test_a_push_on_a_hand_accelerates_the_robot_as_that_wrench_at_the_tool_centre() -> None:
    """By MuJoCo's own Jacobian of the tool centre: M a = J^T F."""
    plant = plant_of(scenario(plant={"joint_friction_Nm": 0.0}))  # dry friction is a constraint, which would answer
    plant.open_hand("a2")
    step(plant, 5)
    wrench = np.array([30.0, -20.0, 10.0, 1.0, -2.0, 3.0])
    model, data, ids = plant.world.model, plant.world.data, plant.world.arms["a2"]
    mujoco.mj_forward(model, data)
    before, J = data.qacc.copy(), np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, J[:3], J[3:], ids.tcp_site)
    plant.push(push(arm="a2", force_N=wrench[:3].tolist(), torque_Nm=wrench[3:].tolist()))
    plant.disturbances.apply(5)
    mujoco.mj_forward(model, data)
    change = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, change, data.qacc - before)
    np.testing.assert_allclose(change, J.T @ wrench, rtol=0, atol=1e-6)  # of the others' welds, which are solved for
    np.testing.assert_array_equal(plant.disturbances.on_hands[1], wrench)
    assert not np.delete(plant.disturbances.on_hands, 1, axis=0).any()


def test_after_a_push_nothing_is_left_of_it_and_before_it_nothing_is_there() -> None:
    plant = plant_of(scenario())
    rows = []
    for tick in range(60):
        if tick == 20:
            plant.push(push(arm="a1", force_N=(0.0, 50.0, 0.0)))
        plant.step()
        rows.append(plant.disturbances.on_hands[0].copy())
    pushed = np.any(rows, axis=1)
    np.testing.assert_array_equal(np.flatnonzero(pushed), np.arange(20, 40))
    assert not plant.world.data.xfrc_applied[plant.world.arms["a1"].hand_body].any()
    assert [seen.effect for seen in plant.disturbances.news] == ["50 N and 0 N m act", "it has ended"]


def test_two_pushes_and_a_bad_grasp_add_up() -> None:
    plant = plant_of(scenario())
    plant.loosen("a1", 20.0)
    plant.push(push(arm="a1", force_N=(0.0, 50.0, 0.0)))
    plant.push(push(arm="a1", force_N=(10.0, 0.0, 0.0)))
    plant.push(push(point="centre_of_mass", force_N=(0.0, 0.0, 5.0)))
    plant.step()
    hand, load = plant.disturbances.on_hands[0], plant.disturbances.on_load
    spurious = load[:3] - (0.0, 0.0, 5.0)
    assert np.linalg.norm(spurious) > 0.1
    np.testing.assert_allclose(hand[:3], np.array([10.0, 50.0, 0.0]) - spurious, rtol=0, atol=1e-12)
    ids = plant.world.arms["a1"]
    np.testing.assert_allclose(plant.world.data.xfrc_applied[ids.hand_body, :3], hand[:3], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(plant.world.data.xfrc_applied[plant.world.load_body], load)


def test_a_push_in_the_middle_of_control_ticks_of_four_steps_has_its_whole_impulse() -> None:
    plant = plant_of(scenario(clock={"control_period_ms": 4}, leader=None))
    for arm in plant.names:
        plant.open_hand(arm)
    plant.push(push(point="centre_of_mass", force_N=(50.0, 0.0, 0.0), for_s=0.010))  # two ticks and a half
    step(plant, 5)
    assert momentum(plant)[0][0] == pytest.approx(0.5, abs=1e-9)
    assert [seen.effect for seen in plant.disturbances.news] == ["50 N and 0 N m act", "it has ended"]


# How it goes over time


amplitudes = st.lists(st.floats(-100.0, 100.0), min_size=6, max_size=6).map(np.array)


@given(amplitudes, st.floats(0.1, 20.0), st.floats(0.2, 60.0), st.integers(0, 99))
def test_a_smooth_push_stays_within_its_amplitude_and_comes_and_goes_gently(
    amplitude: Array, period_s: float, for_s: float, seed: int
) -> None:
    at = smooth(amplitude, period_s, for_s, np.random.default_rng(seed).uniform(0, 2 * math.pi, (len(SINES), 6)))
    values = np.array([at(t) for t in np.linspace(0.0, for_s, 50)])
    assert (np.abs(values) <= np.abs(amplitude) + 1e-9).all()
    np.testing.assert_array_equal(values[[0, -1]], np.zeros((2, 6)))


def test_a_smooth_push_is_the_sum_of_sines_that_the_page_tells_of() -> None:
    event = push(point="front", shape="smooth", for_s=10.0, period_s=3.0, force_N=(4.0, 0.0, -2.0), torque_Nm=(0, 1, 0))
    at = wave_of(event, 7, 3)
    phases = np.random.default_rng([7, 0x9054, 3]).uniform(0.0, 2.0 * math.pi, (3, 6))
    amplitude = (4.0, 0.0, -2.0, 0.0, 1.0, 0.0)
    for t in (0.1, 0.25, 3.7, 9.9):
        s = min(1.0, t / FADE_S, (10.0 - t) / FADE_S)
        for axis in range(6):
            swing = sum(
                weight * math.sin(2 * math.pi * ratio * t / 3.0 + phases[k, axis])
                for k, (ratio, weight) in enumerate([(1.0, 0.5), (1.7, 0.3), (2.9, 0.2)])
            )
            assert at(t)[axis] == pytest.approx((3 * s**2 - 2 * s**3) * amplitude[axis] * swing, abs=1e-12)


def test_an_abrupt_push_jumps_between_values_within_its_amplitude_and_holds_them_as_long_as_told() -> None:
    at = wave_of(push(arm="a1", shape="abrupt", hold_s=0.3, for_s=300.0, force_N=(20.0, 5.0, 0.0)), 1, 0)
    values = np.array([at(t) for t in np.arange(300_000) * 1e-3])
    assert (np.abs(values) <= (20.0, 5.0, 0.0, 0.0, 0.0, 0.0)).all()
    jumps = np.count_nonzero(np.diff(values[:, 0]))
    assert jumps == np.count_nonzero(np.diff(values[:, 1]))  # all components jump together
    assert 300.0 / jumps == pytest.approx(0.3, rel=0.1)  # a thousand intervals: three per cent, one deviation
    distinct = np.unique(values[:, 0])
    assert np.abs(distinct.mean()) < 2.0  # 20 / sqrt(3) / sqrt(1000) is 0.4, one deviation
    assert distinct.std() == pytest.approx(20.0 / math.sqrt(3.0), rel=0.1)


@given(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=30).map(sorted), st.sampled_from(["smooth", "abrupt"]))
def test_a_push_at_a_time_does_not_depend_on_when_it_was_looked_at_before(times: list[float], shape: str) -> None:
    event = push(arm="a1", shape=shape, for_s=5.0, force_N=(20.0, 5.0, 1.0))
    looked_at_often = wave_of(event, 1, 0)
    for t in times:
        np.testing.assert_array_equal(looked_at_often(t), wave_of(event, 1, 0)(t))


def test_every_push_and_every_seed_draws_anew() -> None:
    event = push(arm="a1", shape="abrupt", for_s=5.0, force_N=(20.0, 5.0, 1.0))
    first, same, second, other_seed = (wave_of(event, seed, k)(1.0) for seed, k in ((1, 0), (1, 0), (1, 1), (2, 0)))
    np.testing.assert_array_equal(first, same)
    assert (first[:3] != second[:3]).all()
    assert (first[:3] != other_seed[:3]).all()


# Wherever a run goes on


def test_two_plants_of_one_state_go_on_equally_with_pushes_in_flight() -> None:
    given_ = scenario(4)
    plant, other = plant_of(given_), plant_of(given_)
    plant.push(push(arm="a2", shape="abrupt", hold_s=0.01, for_s=0.2, force_N=(30.0, 30.0, 30.0)))
    plant.push(push(point="left", shape="smooth", period_s=0.1, for_s=0.15, torque_Nm=(0.0, 0.0, 9.0)))
    plant.loosen("a3", 5.0)
    arms = ("a1", "a2", "a3", "a4")
    drive(plant, 50, arms)
    saved = pack(plant.state())
    other.restore(unpack(saved))
    assert pack(other.state()) == saved
    np.testing.assert_array_equal(drive(plant, 200, arms), drive(other, 200, arms))  # beyond the end of both
    assert pack(plant.state()) == pack(other.state())
    assert plant.disturbances.news == other.disturbances.news
    assert len(plant.disturbances.news) == 4


def test_a_push_goes_on_in_a_world_with_another_robot_and_ends_with_its_own() -> None:
    plant = plant_of(scenario(2, load={"struts": 4}, team={"count": 2}))
    plant.push(push(arm="a2", force_N=(0.0, 20.0, 0.0)))
    plant.push(push(point="front", force_N=(3.0, 0.0, 0.0)))
    step(plant, 5)
    plant.move_to(build_world(plant.world.scenario, {"a1": 0, "a2": 1, "a3": 2}))
    plant.step()
    np.testing.assert_array_equal(plant.disturbances.on_hands[:, 1], [0.0, 20.0, 0.0])
    assert plant.disturbances.on_load[0] == 3.0
    plant.disturbances.news.clear()
    plant.move_to(build_world(plant.world.scenario, {"a1": 0, "a3": 2}))
    (seen,) = plant.disturbances.news
    assert (seen.event, seen.effect) == (push(arm="a2", force_N=(0.0, 20.0, 0.0)), "its robot has been taken away")
    plant.step()
    np.testing.assert_array_equal(plant.disturbances.on_hands, np.zeros((2, 6)))
    assert plant.disturbances.on_load[0] == 3.0


PUSHED = {
    "events": [
        {
            "at_s": 0.01,
            "kind": "push",
            "arm": "a2",
            "for_s": 0.07,
            "shape": "abrupt",
            "hold_s": 0.005,
            "force_N": [20.0, 20.0, 5.0],
        },
        {"at_s": 0.02, "kind": "push", "point": "front", "for_s": 0.02, "torque_Nm": [0.0, 0.0, 3.0]},
    ]
}


def test_two_runs_with_pushes_leave_the_same_bytes_and_tell_when_they_act_and_end(tmp_path: Path) -> None:
    for name in ("one", "two"):
        begin(tmp_path / name, PUSHED)
    one, two = ((tmp_path / name / "trace.parquet").read_bytes() for name in ("one", "two"))
    assert one == two
    told = [
        (event["tick"], event["kind"], event.get("agent", event.get("point")), event.get("effect"))
        for event in read_events(tmp_path / "one")
        if event.get("event") == "push"
    ]
    assert [(tick, kind, whom) for tick, kind, whom, _ in told] == [
        (10, "ordered", "a2"),
        (11, "seen", "a2"),
        (20, "ordered", "front"),
        (21, "seen", "front"),
        (40, "seen", "front"),
        (80, "seen", "a2"),
    ]
    assert told[3][3] == "0 N and 3 N m act"
    assert told[4][3] == told[5][3] == "it has ended"
    trace = read_trace(tmp_path / "one" / "trace.parquet")
    np.testing.assert_array_equal(trace["load.disturbance"][:, 5], [*[0.0] * 20, *[3.0] * 20, *[0.0] * 50])
    np.testing.assert_array_equal(trace["a1.disturbance"], np.zeros((90, 6)))
    assert np.flatnonzero(trace["a2.disturbance"].any(axis=1)).tolist() == list(range(10, 80))


def test_a_run_that_was_killed_with_a_push_in_flight_goes_on_with_the_same_push(tmp_path: Path) -> None:
    begin(tmp_path / "whole", PUSHED)
    whole = read_trace(tmp_path / "whole" / "trace.parquet")["a2.disturbance"]
    bytes_ = set()
    for name in ("one", "two"):
        assert begin(tmp_path / name, PUSHED, KILLED_AT) is None
        go_on(tmp_path / name)
        trace = tmp_path / name / "trace.parquet"
        bytes_.add(trace.read_bytes())
        np.testing.assert_array_equal(read_trace(trace)["a2.disturbance"], whole)
    assert len(bytes_) == 1


def test_the_noise_of_the_sensors_does_not_depend_on_pushes() -> None:
    """Streams are apart: what a push draws takes nothing from anybody else."""
    calm, pushed = plant_of(scenario(2)), plant_of(scenario(2))
    pushed.push(push(arm="a1", shape="abrupt", hold_s=0.001, force_N=(1e-9, 0.0, 0.0)))
    for _ in range(20):
        one, two = calm.read(), pushed.read()
        np.testing.assert_allclose(one["a2"].q, two["a2"].q, rtol=0, atol=1e-9)
        for plant in (calm, pushed):
            plant.command("a1", (0.0,) * 7, (0.0,) * 3, NO_STIFFNESS)
            plant.step()
