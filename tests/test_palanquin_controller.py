"""The preset `palanquin`, one arm at a time: what each part pushes, what it leaves alone, and how it begins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from one_arm import HOME, arm, sensed

from agents.controllers.interface import Effort, Sensed
from agents.controllers.palanquin import PalanquinController, palanquin_law
from agents.controllers.palanquin_gains import PalanquinGains
from agents.equations.saturation import yield_moment
from agents.equations.yaw import reaction_moment, yaw_moment, yaw_sine

Array = NDArray[np.float64]
STILL = np.zeros(7)
TAU_MAX = np.array([87.0] * 4 + [12.0] * 3)
NO_MEMORY: dict[str, Any] = {"observer_rate_1_s": 0.0, "force_rate_1_s": 0.0, "posture_stiffness_Nm_rad": 0.0}
"""The springs of the hand alone."""


def gravity(q: Array) -> Array:
    return arm().snapshot(q, STILL).g


def hand_wrench(effort: Effort, q: Array) -> Array:
    """The wrench on the load that holds this torque at rest, (6,); the torque must be that of one."""
    J, tau = arm().snapshot(q, STILL).J, effort.torque - gravity(q)
    wrench: Array = np.asarray(np.linalg.lstsq(J.T, tau, rcond=None)[0], dtype=np.float64)
    np.testing.assert_allclose(J.T @ wrench, tau, atol=1e-8)
    return wrench


def steady(**gains: Any) -> PalanquinController:
    """A controller that holds the hand where it is at home, taken over with nothing in it."""
    controller = PalanquinController(arm(), **gains)
    controller.step(sensed(HOME, tau=gravity(HOME)), 1e-3)
    return controller


# How it begins.


def test_at_its_first_step_it_bears_what_the_arm_bore_but_for_the_leak() -> None:
    J = arm().snapshot(HOME, STILL).J
    borne = gravity(HOME) + J.T @ [0.0, 0.0, 49.0, 1.0, -2.0, 0.0]
    effort = PalanquinController(arm()).step(sensed(HOME, tau=borne), 1e-3)
    np.testing.assert_allclose(hand_wrench(effort, HOME), np.array([0, 0, 49.0, 1.0, -2.0, 0]) * 10 / 18, atol=1e-7)


def test_a_load_that_comes_later_is_taken_over_within_a_second() -> None:
    J, controller = arm().snapshot(HOME, STILL).J, steady()
    borne = gravity(HOME) + J.T @ [0.0, 0.0, 25.0, 0.0, 0.0, 0.0]
    for _ in range(1000):  # as if a brake held the arm still and something pulled its hand down
        effort = controller.step(sensed(HOME, tau=borne), 1e-3)
    assert hand_wrench(effort, HOME)[2] == pytest.approx(25.0 * 10 / 18, rel=1e-3)


def test_steps_of_one_millisecond_and_of_four_remember_the_same() -> None:
    J = arm().snapshot(HOME, STILL).J
    borne, held = gravity(HOME) + J.T @ [0.0, 0.0, 25.0, 0.0, 0.0, 0.0], {}
    for dt_ms in (1, 4):
        controller = steady()
        for _ in range(200 // dt_ms):
            effort = controller.step(Sensed(HOME, STILL, borne, np.array([3.0, -1.0, 0, 0, 0, 0])), 1e-3 * dt_ms)
        held[dt_ms] = effort.torque
    np.testing.assert_allclose(held[1], held[4], atol=1e-9)


def test_it_repeats_bit_by_bit() -> None:
    rng = np.random.default_rng(1)
    states = [
        Sensed(HOME + 0.02 * rng.standard_normal(7), 0.1 * rng.standard_normal(7), gravity(HOME), np.zeros(6))
        for _ in range(20)
    ]
    first, second = ([law.step(state, 1e-3) for state in states] for law in (steady(), steady()))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.torque, other.torque)


# Height, roll, pitch.


@pytest.mark.parametrize("up_m", [0.01, -0.01])
def test_a_hand_off_its_height_is_lifted_and_pushed_no_other_way(up_m: float) -> None:
    controller = PalanquinController(arm(), **NO_MEMORY)
    controller.carry_at(float(arm().snapshot(HOME, STILL).p_BE[2]) + up_m)
    effort = controller.step(sensed(HOME), 1e-3)
    tilt_of_home = 1e-3  # HOME points straight down to that many rad
    np.testing.assert_allclose(hand_wrench(effort, HOME), [0, 0, 8000 * up_m, 0, 0, 0], atol=600 * tilt_of_home)
    assert hand_wrench(effort, HOME)[2] == pytest.approx(8000 * up_m, rel=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("angle", [0.01, -0.01])
def test_a_tilted_hand_is_turned_back_about_that_axis(axis: int, angle: float) -> None:
    now = arm().snapshot(HOME, STILL)
    turn = np.zeros(6)
    turn[3 + axis] = angle
    q = HOME + np.linalg.pinv(now.J) @ turn
    wrench = hand_wrench(steady(**NO_MEMORY).step(sensed(q), 1e-3), q)
    # Of second order in the turn: it moves the hand by some tenths of a millimetre.
    assert wrench[3 + axis] == pytest.approx(-600 * angle, rel=0.02)
    assert abs(wrench[4 - axis]) < 0.02 * 600 * abs(angle)


def test_the_damper_takes_power_in_every_direction_of_the_hand() -> None:
    J, controller = arm().snapshot(HOME, STILL).J, steady(**NO_MEMORY)
    for row in range(6):
        qd = np.asarray(np.linalg.pinv(J)[:, row] * 0.05, dtype=np.float64)
        now = arm().snapshot(HOME, qd)
        effort = controller.step(sensed(HOME, qd), 1e-3)
        assert qd @ (effort.torque - now.g - now.C @ qd) < -0.01
        assert effort.residual_W <= 0.0


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_lifting_what_the_observer_took_over_is_power_that_no_spring_gives(up: float) -> None:
    J = arm().snapshot(HOME, STILL).J
    borne = gravity(HOME) + J.T @ [0.0, 0.0, 49.0, 0.0, 0.0, 0.0]
    controller = PalanquinController(arm(), force_rate_1_s=0.0)
    controller.step(sensed(HOME, tau=borne), 1e-3)
    qd = np.asarray(np.linalg.pinv(J)[:, 2] * 0.01 * up, dtype=np.float64)
    controller._law.inputs["p"][:] = arm().snapshot(HOME, qd).M @ qd  # it has moved like that before
    effort = controller.step(sensed(HOME, qd, borne), 1e-3)
    # 27 N at 10 mm/s, less what the damper of some 400 N s/m takes.
    assert effort.residual_W == pytest.approx(up * 0.01 * 49.0 * 10 / 18, abs=0.06)


# What is left: the elbow.


def test_the_posture_turns_the_elbow_back_and_leaves_the_hand_alone() -> None:
    now = arm().snapshot(HOME, STILL)
    self_motion = np.linalg.svd(now.J)[2][6]
    for side in (0.1, -0.1):
        q = HOME + side * self_motion
        there = arm().snapshot(q, STILL)
        efforts = [steady(posture_stiffness_Nm_rad=k).step(sensed(q), 1e-3).torque for k in (20.0, 0.0)]
        acceleration = there.M_inv @ (efforts[0] - efforts[1])
        # Rounding through an inverse of condition 1e4.
        np.testing.assert_allclose(there.J @ acceleration, 0.0, atol=1e-9)
        assert acceleration @ self_motion * side < -0.1


# The plane.


def moved(x: float, y: float) -> Array:
    now = arm().snapshot(HOME, STILL)
    q: Array = HOME + np.linalg.pinv(now.J) @ [x, y, 0, 0, 0, 0]
    return q


@pytest.mark.parametrize("way", [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.02), (0.0, -0.02)])
def test_a_hand_ahead_of_its_base_pulls_back_softly_and_the_base_comes_after(way: tuple[float, float]) -> None:
    effort = steady(**NO_MEMORY).step(sensed(moved(*way)), 1e-3)
    # The step by the Jacobian is off by half a millimetre at 20 mm.
    np.testing.assert_allclose(hand_wrench(effort, moved(*way))[:2], [-40 * x for x in way], atol=40 * 6e-4)
    np.testing.assert_allclose(effort.base_force[:2], [2000 * x for x in way], atol=2000 * 6e-4)


def test_a_hand_that_pushes_less_than_it_is_told_is_given_more() -> None:
    """Dry friction: the wrist feels nothing of the wanted -0.8 N."""
    controller, q = steady(observer_rate_1_s=0.0), moved(0.02, 0.0)
    pushes = [hand_wrench(controller.step(sensed(q), 1e-3), q)[0] for _ in range(300)]
    assert pushes[0] == pytest.approx(-0.8, abs=0.04)
    assert pushes[-1] == pytest.approx(-0.8 * (1 + 9 * (1 - np.exp(-0.3))), rel=0.05)


def test_the_wrist_is_read_in_the_hands_axes() -> None:
    """The hand is tilted and turned: straight down, its axes in the base's would be a symmetric matrix."""
    q = HOME + np.array([0, 0, 0, 0, 0, 0.4, 0.3])
    controller = PalanquinController(arm(), observer_rate_1_s=0.0)
    for _ in range(301):
        effort = controller.step(Sensed(q, STILL, gravity(q), np.array([0.0, 2.0, 0, 0, 0, 0])), 1e-3)
    felt = arm().snapshot(q, STILL).R_BE @ [0.0, 2.0, 0.0]
    push = hand_wrench(effort, q)[:2]
    np.testing.assert_allclose(push, -9 * (1 - np.exp(-0.3)) * felt[:2], atol=1e-6)


# Yaw.


def ahead(psi: float) -> Array:
    return np.array([np.cos(psi), np.sin(psi), 0.0])


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi), st.floats(-5, 5))
def test_the_yaw_spring_turns_the_hand_back_by_the_sine_and_damps_it(psi: float, held: float, rate: float) -> None:
    moment = yaw_moment(ahead(psi), ahead(held), rate, 60.0, 10.0)
    assert moment == pytest.approx(60.0 * np.sin(held - psi) - 10.0 * rate, abs=1e-12)
    assert yaw_sine(ahead(held), ahead(psi)) == pytest.approx(np.sin(psi - held), abs=1e-12)


def test_the_base_is_held_against_what_its_hand_does_to_it() -> None:
    """A hand half a metre ahead pushes 10 N to the left: the base is pushed to the right there, turned to the right by
    5 N m, and its drive turns it to the left."""
    assert reaction_moment(np.array([0.5, 0.0, 0.4]), np.array([0.0, 10.0]), 0.0) == 5.0
    assert reaction_moment(np.array([0.0, 0.5, 0.4]), np.array([10.0, 0.0]), 2.0) == -3.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_turned_hand_is_turned_back_within_the_wrists_means_and_the_base_follows(side: float) -> None:
    q = HOME - side * np.array([0, 0, 0, 0, 0, 0, 0.2])  # joint 7 turns about the hand's own axis, which points down
    effort = steady(**NO_MEMORY).step(sensed(q), 1e-3)
    assert hand_wrench(effort, q)[5] == pytest.approx(-10.0 * side, abs=1e-6)  # 150 sin 0.2 is more than 10
    held = steady(**NO_MEMORY, base_yaw_hold=False).step(sensed(q), 1e-3)
    assert held.base_force[2] == pytest.approx(6.0 * side * np.sin(0.2), rel=1e-3)
    assert effort.base_force[2] - held.base_force[2] == pytest.approx(-10.0 * side, abs=1e-6)


# The wrist.


@given(st.lists(st.floats(-60, 60), min_size=6, max_size=6).map(np.array), st.integers(0, 1000))
def test_a_wrist_at_its_limit_gives_up_a_moment_and_no_force(wrench: Array, seed: int) -> None:
    J = arm().snapshot(HOME + 0.2 * np.random.default_rng(seed).standard_normal(7), STILL).J
    tau = yield_moment(J.T @ wrench, J[3:], TAU_MAX, (5,))
    assert abs(tau[5]) <= 12.0 + 1e-9
    rest, *_ = np.linalg.lstsq(J.T, tau, rcond=None)
    # Still the torque of a wrench (J^T has 6 columns for 7 joints), and its force is the wanted one.
    np.testing.assert_allclose(J.T @ rest, tau, atol=1e-7)
    np.testing.assert_allclose(rest[:3], wrench[:3], atol=1e-6)


def test_a_wrist_within_its_limits_is_left_alone() -> None:
    tau = np.array([80.0, -80.0, 10.0, 5.0, 11.9, -11.9, 0.0])
    J_w = np.random.default_rng(1).standard_normal((3, 7))
    # Rounding of the bound.
    np.testing.assert_allclose(yield_moment(tau, J_w, TAU_MAX, (4, 5, 6)), tau, atol=1e-13)


# The whole.

SWITCHED: list[dict[str, Any]] = [
    {},
    {"stiffen": 0.0},
    {"stiffness_rate_1_s": 0.0},
    {"observer_rate_1_s": 0.0},
    {"plane_stiffness_N_m": 0.0, "plane_damping_Ns_m": 0.0},
    {"force_rate_1_s": 0.0},
    {"yaw_stiffness_Nm_rad": 0.0, "yaw_damping_Nms_rad": 0.0},
    {"base_yaw_hold": False, "base_yaw_stiffness_Nm_rad": 0.0},
    {"posture_stiffness_Nm_rad": 0.0, "posture_damping_Nms_rad": 0.0},
    {"wrist_yields": False},
]


@pytest.mark.parametrize("gains", SWITCHED, ids=str)
def test_every_part_can_be_switched_off_and_the_traced_law_is_the_law(gains: dict[str, Any]) -> None:
    rng = np.random.default_rng(1)
    controller = PalanquinController(arm(), **gains)
    inputs = controller._law.inputs
    start = Sensed(HOME, STILL, gravity(HOME), np.zeros(6))
    controller.step(start, 1e-3)
    for _ in range(5):
        state = Sensed(
            HOME + 0.05 * rng.standard_normal(7),
            0.3 * rng.standard_normal(7),
            gravity(HOME) + 5 * rng.standard_normal(7),
            5 * rng.standard_normal(6),
        )
        memory = {name: inputs[name].copy() for name in ("p", "r", "f", "K", "p_held", "up_E", "ahead_held", "q_held")}
        effort = controller.step(state, 1e-3)
        times = {name: inputs[name] for name in ("dt_s", "keep_r", "keep_f", "rise")}
        torque, base_force, stiffness, *_ = palanquin_law(
            PalanquinGains(**gains), arm().chain, TAU_MAX, q=state.q, qd=state.qd, tau=state.tau, wrench=state.wrench,
            **memory, **times,
        )  # fmt: skip
        # The same sums in another order, through an inverse of condition 1e4.
        np.testing.assert_allclose(effort.torque, torque, rtol=1e-8, atol=1e-8 * np.abs(torque).max())
        np.testing.assert_allclose(effort.base_force, base_force, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(effort.stiffness, stiffness, rtol=1e-8)
