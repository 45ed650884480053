"""Metrics of traces made by hand, whose answers are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_server.metrics import (
    TraceFacts,
    internal_forces,
    physical_metrics,
    roll_pitch_yaw_deg,
    rotation_matrices,
    tilt_deg,
)

Array = NDArray[Any]

FOUR_GRASPS = {"a1": (0.9, 0.5, 0.7), "a2": (-0.9, -0.5, 0.7), "a3": (-0.9, 0.5, 0.7), "a4": (0.9, -0.5, 0.7)}
TORQUE_MAX = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
EXACT = 1e-12
"""Rounding of a few operations on numbers near 1."""


def quat(axis: tuple[float, float, float], angle_deg: Any) -> Array:
    """Unit quaternions (rows, 4), w first, of turns about an axis."""
    half = np.radians(np.atleast_1d(angle_deg)) / 2
    n = np.array(axis) / np.linalg.norm(axis)
    return np.column_stack([np.cos(half), np.sin(half)[:, None] * n])


def product(a: Array, b: Array) -> Array:
    """Quaternions of turning by b first, then by a."""
    (w, x, y, z), (p, q, r, s) = a.T, b.T
    return np.column_stack(
        [
            w * p - x * q - y * r - z * s,
            w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q,
            w * s + x * r - y * q + z * p,
        ]
    )


def still(rows: int = 11, dt_s: float = 0.1, arms: tuple[str, ...] = ("a1",)) -> dict[str, Array]:
    """A trace in which nothing moves and nobody pulls."""
    trace: dict[str, Array] = {
        "time_s": dt_s * np.arange(rows),
        "load.position": np.zeros((rows, 3)),
        "load.quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (rows, 1)),
        "load.linear_velocity": np.zeros((rows, 3)),
        "load.angular_velocity": np.zeros((rows, 3)),
        "leader.force": np.zeros((rows, 3)),
    }
    for arm in arms:
        for column, width in (("q", 7), ("qd", 7), ("tau", 7), ("base", 3), ("base_velocity", 3), ("base_force", 3)):
            trace[f"{arm}.{column}"] = np.zeros((rows, width))
        trace[f"{arm}.grip"] = np.zeros((rows, 6))
    return trace


def facts(
    goal: tuple[float, float] | None = (2.0, 0.0), arms: tuple[str, ...] = ("a1",), mass: float = 20.0
) -> TraceFacts:
    return TraceFacts(arms, goal, mass, (0.0, 0.0, 0.4), {arm: FOUR_GRASPS[arm] for arm in arms}, TORQUE_MAX)


def measured(trace: dict[str, Array], given_facts: TraceFacts | None = None) -> dict[str, Any]:
    return dict(physical_metrics(trace, given_facts or facts()))


def on_x(*x: float) -> dict[str, Array]:
    trace = still(len(x), dt_s=1.0)
    trace["load.position"][:, 0] = x
    return trace


# Attitude


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, -1, 0), (3, 4, 0)])
@pytest.mark.parametrize("angle", [0.001, 0.5, 30.0, 90.0, 179.0])
def test_tilt_is_the_angle_of_a_turn_about_any_level_axis(axis: tuple[float, float, float], angle: float) -> None:
    assert tilt_deg(quat(axis, angle))[0] == pytest.approx(angle, rel=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 40.0, -170.0, 400.0])
def test_tilt_does_not_see_yaw(yaw: float) -> None:
    turned = product(quat((0, 0, 1), yaw), quat((1, 2, 0), 3.0))
    assert tilt_deg(turned)[0] == pytest.approx(3.0, rel=1e-9)
    assert tilt_deg(-turned)[0] == pytest.approx(3.0, rel=1e-9)  # the same attitude


def test_tilt_is_measured_against_the_worlds_vertical_not_against_the_start() -> None:
    trace = still(4)
    trace["load.quat_wxyz"] = quat((1, 0, 0), [1.0, 1.0, 3.0, 1.0])
    found = measured(trace)
    assert found["tilt_max_deg"] == pytest.approx(3.0, rel=1e-9)
    assert found["tilt_rms_deg"] == pytest.approx(np.sqrt((1 + 1 + 9 + 1) / 4), rel=1e-9)


@pytest.mark.parametrize("turns", [1.0, -1.0])
def test_yaw_over_half_a_turn_is_not_cut_off(turns: float) -> None:
    trace = still(101)
    yaw = 10.0 + turns * np.linspace(0.0, 400.0, 101)
    trace["load.quat_wxyz"] = product(quat((0, 0, 1), yaw), quat((1, 0, 0), 2.0).repeat(101, axis=0))
    assert measured(trace)["yaw_max_deg"] == pytest.approx(400.0, rel=1e-9)  # from its start at 10 degrees


def test_roll_pitch_and_yaw_are_turns_about_the_worlds_axes_in_this_order() -> None:
    pose = product(quat((0, 0, 1), 50.0), product(quat((0, 1, 0), -20.0), quat((1, 0, 0), 10.0)))
    np.testing.assert_allclose(roll_pitch_yaw_deg(pose), [[10.0, -20.0, 50.0]], rtol=1e-12)


def test_a_rotation_matrix_turns_vectors_as_its_quaternion_says() -> None:
    R = rotation_matrices(quat((0, 0, 1), [90.0]))[0]
    np.testing.assert_allclose(R @ [1, 2, 3], [-2, 1, 3], atol=EXACT)
    R = rotation_matrices(quat((1, 0, 0), [90.0]))[0]
    np.testing.assert_allclose(R @ [1, 2, 3], [1, -3, 2], atol=EXACT)
    R = rotation_matrices(quat((1, 1, 1), [120.0]))[0]
    np.testing.assert_allclose(R @ [1, 2, 3], [3, 1, 2], atol=EXACT)


def test_sag_counts_both_up_and_down_from_the_height_at_the_start() -> None:
    trace = still(4)
    trace["load.position"][:, 2] = [0.1, 0.098, 0.103, 0.101]
    found = measured(trace)
    assert found["sag_max_mm"] == pytest.approx(3.0, rel=1e-9)
    assert found["sag_rms_mm"] == pytest.approx(np.sqrt((4 + 9 + 1) / 4), rel=1e-9)


# Path and goal


def test_path_length_is_the_way_there_and_back_in_the_plane() -> None:
    trace = still(4)
    trace["load.position"][:] = [[0, 0, 0], [3, 4, 1], [0, 0, -2], [0, 1, 0]]
    assert measured(trace)["path_length_m"] == pytest.approx(5 + 5 + 1, rel=EXACT)


def test_goal_error_is_the_distance_at_the_end_in_the_plane() -> None:
    trace = still(3)
    trace["load.position"][:] = [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.7, 0.4, 5.0]]
    assert measured(trace)["goal_error_m"] == pytest.approx(0.5, rel=EXACT)


def test_a_load_that_never_comes_close_does_not_arrive() -> None:
    assert measured(on_x(0.0, 1.0, 1.8, 1.899))["arrival_time_s"] is None


def test_a_load_at_its_goal_from_the_start_arrives_at_once() -> None:
    assert measured(on_x(2.0, 1.95, 2.05))["arrival_time_s"] == 0.0


def test_a_load_that_leaves_the_goal_again_arrives_when_it_stays() -> None:
    assert measured(on_x(0.0, 1.95, 2.3, 2.05, 2.0))["arrival_time_s"] == 3.0


def test_a_load_that_comes_close_in_the_last_row_arrives_then() -> None:
    assert measured(on_x(0.0, 1.0, 1.95))["arrival_time_s"] == 2.0


def test_a_load_that_is_gone_in_the_last_row_has_not_arrived() -> None:
    assert measured(on_x(0.0, 2.0, 2.0, 2.2))["arrival_time_s"] is None


def test_overshoot_is_how_far_past_the_goal_along_the_way_to_it() -> None:
    assert measured(on_x(0.0, 1.5, 2.25, 2.0))["overshoot_m"] == pytest.approx(0.25, rel=EXACT)
    assert measured(on_x(0.0, 1.5, 1.9))["overshoot_m"] == 0.0
    beside = still(3)
    beside["load.position"][:, 1] = [0.0, 3.0, 0.0]  # across the way: not past the goal
    assert measured(beside)["overshoot_m"] == 0.0
    slanted = still(3)
    slanted["load.position"][:, :2] = [[1.0, 1.0], [4.0, 5.0], [4.3, 5.4]]
    assert measured(slanted, facts(goal=(4.0, 5.0)))["overshoot_m"] == pytest.approx(0.5, rel=EXACT)


def test_the_speed_at_the_end_is_the_largest_of_the_last_second_in_the_plane() -> None:
    trace = still(41, dt_s=0.1)
    speed = trace["load.linear_velocity"]
    speed[29] = [9.0, 0.0, 0.0]  # 1.1 s before the end
    speed[33] = [0.003, -0.004, 2.0]
    assert measured(trace)["end_speed_mm_s"] == pytest.approx(5.0, rel=EXACT)


def test_drift_is_the_displacement_per_minute_of_a_load_that_nobody_leads() -> None:
    trace = still(4, dt_s=10.0)
    trace["load.position"][:, :2] = [[0.0, 0.0], [5.0, 5.0], [5.0, -5.0], [0.03, 0.04]]
    trace["leader.force"][:] = 7.0
    found = measured(trace, facts(goal=None))
    assert found["drift_mm_per_min"] == pytest.approx(100.0, rel=1e-9)  # 50 mm in half a minute, whatever the way
    for name in ("goal_error_m", "arrival_time_s", "overshoot_m", "leader_force_max_N", "leader_impulse_Ns"):
        assert found[name] is None
    assert measured(on_x(0.0, 1.0))["drift_mm_per_min"] is None


def test_a_trace_of_one_row_has_no_drift_and_no_duration() -> None:
    found = measured(still(1), facts(goal=None))
    assert found["duration_s"] == 0.0
    assert found["drift_mm_per_min"] is None


def test_a_trace_without_rows_has_no_metrics() -> None:
    with pytest.raises(ValueError, match="no rows"):
        measured(still(0))


# Forces


def test_load_share_is_each_hands_part_of_the_weight() -> None:
    trace = still(2, arms=("a1", "a2"))
    trace["a1.grip"][:, 2] = [30.0, 50.0]
    trace["a2.grip"][:, 2] = 156.2
    trace["a1.grip"][:, 0] = 999.0  # sideways carries nothing
    found = measured(trace, facts(arms=("a1", "a2"), mass=20.0))
    assert found["load_share"] == pytest.approx({"a1": 40 / 196.2, "a2": 156.2 / 196.2}, rel=1e-12)
    assert sum(found["load_share"].values()) == pytest.approx(1.0, rel=1e-12)


def test_the_largest_grip_is_a_force_of_one_hand() -> None:
    trace = still(3, arms=("a1", "a2"))
    trace["a1.grip"][1] = [2.0, 3.0, 6.0, 500.0, 500.0, 500.0]
    trace["a2.grip"][2] = [0.0, 0.0, -6.0, 0.0, 0.0, 0.0]
    assert measured(trace, facts(arms=("a1", "a2")))["grip_force_max_N"] == pytest.approx(7.0, rel=EXACT)


def test_the_leaders_impulse_is_its_pull_over_time() -> None:
    trace = still(11, dt_s=0.5)
    trace["leader.force"][:] = [3.0, -4.0, 0.0]  # 5 N for 5 s
    found = measured(trace)
    assert found["leader_impulse_Ns"] == pytest.approx(25.0, rel=1e-12)
    assert found["leader_force_max_N"] == pytest.approx(5.0, rel=EXACT)


# Effort


def test_energy_is_motor_power_over_time_whichever_way_it_flows() -> None:
    trace = still(11, dt_s=0.2)
    trace["a1.tau"][:, 0], trace["a1.qd"][:, 0] = 10.0, 0.5
    trace["a1.tau"][:, 3], trace["a1.qd"][:, 3] = -4.0, 0.25  # a motor that brakes costs as well
    assert measured(trace)["energy_J"] == pytest.approx(2.0 * (5.0 + 1.0), rel=1e-12)


def test_a_bases_energy_counts_its_force_in_its_own_frame_along_its_way_in_the_world() -> None:
    trace = still(11, dt_s=0.2)
    trace["a1.base"][:, 2] = np.pi / 2
    trace["a1.base_force"][:] = [8.0, 6.0, 3.0]  # in the world: x -6, y 8
    trace["a1.base_velocity"][:] = [0.5, 1.0, 2.0]
    assert measured(trace)["energy_J"] == pytest.approx(2.0 * abs(-6 * 0.5 + 8 * 1.0 + 3 * 2.0), rel=1e-12)


def test_torque_is_judged_joint_by_joint_against_its_own_limit() -> None:
    trace = still(2)
    trace["a1.tau"][0, :] = [43.5, 0, 0, 0, 0, 0, -9.0]
    found = measured(trace)
    assert found["torque_limit_fraction"] == pytest.approx(0.75, rel=EXACT)
    assert found["torque_rms_Nm"] == pytest.approx(np.sqrt((43.5**2 + 81) / 14), rel=1e-12)


# Internal forces


def resultant(wrenches: Array, arms_W: Array) -> Array:
    """G h: force and moment about the centre of mass of all grips together, (rows, 6)."""
    force, moment = wrenches[..., :3], wrenches[..., 3:] + np.cross(arms_W, wrenches[..., :3])
    return np.concatenate([force.sum(axis=1), moment.sum(axis=1)], axis=1)


def around(*grasps: tuple[float, float, float]) -> Array:
    return np.array([grasps], dtype=float)


def grips(*wrenches: tuple[float, ...]) -> Array:
    return np.array([wrenches], dtype=float)


def test_one_arm_has_no_internal_force_whatever_it_does() -> None:
    rng = np.random.default_rng(1)
    h, arms = rng.normal(scale=50, size=(20, 1, 6)), rng.normal(size=(20, 1, 3))
    # Rounding of a solve whose condition grows with the square of lever over its mean, here up to some hundred.
    np.testing.assert_allclose(internal_forces(h, arms), 0, atol=1e-9)


def test_a_squeeze_is_all_internal() -> None:
    arms = around((0.8, 0, 0), (-0.8, 0, 0))
    squeeze = grips((-30, 0, 0, 0, 0, 0), (30, 0, 0, 0, 0, 0))
    np.testing.assert_allclose(internal_forces(squeeze, arms), squeeze, atol=1e-12)


def test_two_hands_that_wring_the_load_are_all_internal() -> None:
    arms = around((0.8, 0, 0), (-0.8, 0, 0))
    wring = grips((0, 0, 0, 7, 0, 0), (0, 0, 0, -7, 0, 0))
    np.testing.assert_allclose(internal_forces(wring, arms), wring, atol=1e-12)


def test_a_weight_that_is_shared_evenly_is_not_internal() -> None:
    arms = around(*((x, y, 0.3) for x in (0.9, -0.9) for y in (0.5, -0.5)))
    weight = np.zeros((1, 4, 6))
    weight[..., 2] = 49.05
    np.testing.assert_allclose(internal_forces(weight, arms), 0, atol=1e-12)


def test_the_internal_part_of_a_mixed_grip_is_the_squeeze_in_it() -> None:
    arms = around((0.8, 0, 0), (-0.8, 0, 0))
    mixed = grips((-30, 0, 49, 0, 0, 0), (30, 0, 49, 0, 0, 0))
    squeeze = grips((-30, 0, 0, 0, 0, 0), (30, 0, 0, 0, 0, 0))
    np.testing.assert_allclose(internal_forces(mixed, arms), squeeze, atol=1e-12)


@given(
    count=st.integers(1, 6),
    seed=st.integers(0, 2**32 - 1),
    spread=st.floats(0.2, 3.0),
)
@settings(max_examples=60)
def test_internal_forces_move_nothing_and_taking_them_away_twice_changes_nothing(
    count: int, seed: int, spread: float
) -> None:
    rng = np.random.default_rng(seed)
    h, arms = rng.uniform(-100, 100, (3, count, 6)), rng.uniform(-spread, spread, (3, count, 3))
    internal = internal_forces(h, arms)
    # Rounding of a 6 x 6 solve on numbers of 100 N at levers of up to 5 m.
    np.testing.assert_allclose(resultant(internal, arms), 0, atol=1e-8)
    np.testing.assert_allclose(internal_forces(internal, arms), internal, atol=1e-8)
    np.testing.assert_allclose(internal_forces(h - internal, arms), 0, atol=1e-8)


def test_internal_force_of_a_run_is_taken_at_the_grasps_of_the_turned_load() -> None:
    """Two hands squeeze along the load's x while the load is turned: whole and only if the levers turn with it."""
    trace = still(2, arms=("a1", "a2"))
    trace["load.quat_wxyz"] = quat((0, 0, 1), [50.0, 50.0])
    along = np.array([np.cos(np.radians(50.0)), np.sin(np.radians(50.0)), 0.0])
    trace["a1.grip"][:, :3], trace["a2.grip"][:, :3] = -30.0 * along, 30.0 * along
    grasps = {"a1": (0.8, 0.0, 0.4), "a2": (-0.8, 0.0, 0.4)}
    here = TraceFacts(("a1", "a2"), None, 20.0, (0.0, 0.0, 0.4), grasps, TORQUE_MAX)
    assert measured(trace, here)["internal_force_rms_N"] == pytest.approx(30.0, rel=1e-12)
