"""The preset `better`: yaw is held against the base, the task is not touched, and no error pushes sideways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from agents.controllers.interface import Sensed
from agents.equations.null_space import null_projection
from agents.equations.saturation import yield_moment
from agents.equations.task import dynamically_consistent_inverse, task_inertia
from agents.equations.yaw import yaw_moment

HOME = np.array([0.0, -0.1, 0.0, -2.1, 0.0, 2.0, np.pi / 4])


def ahead(psi: float) -> np.ndarray:
    return np.array([np.cos(psi), np.sin(psi), 0.0])


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi), st.floats(-5, 5))
def test_the_yaw_spring_turns_the_hand_back_by_the_sine_and_damps_it(psi: float, held: float, rate: float) -> None:
    moment = yaw_moment(ahead(psi), ahead(held), rate, 60.0, 10.0)
    assert moment == pytest.approx(60.0 * np.sin(held - psi) - 10.0 * rate, abs=1e-12)


def test_a_torque_that_is_projected_does_not_accelerate_the_task() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        now = ArmModel("panda").snapshot(HOME + 0.3 * rng.standard_normal(7), np.zeros(7))
        J = now.J[2:5]
        Jbar = dynamically_consistent_inverse(J, now.M_inv, task_inertia(J, now.M_inv))
        tau = null_projection(J, Jbar, 50.0 * rng.standard_normal(7))
        # Rounding through an inverse of condition 1e3.
        np.testing.assert_allclose(J @ now.M_inv @ tau, 0.0, atol=1e-10)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_hand_that_was_turned_is_turned_back_by_better_and_left_by_the_paper(side: float) -> None:
    accelerations = {}
    turned = HOME + side * np.array([0, 0, 0, 0, 0, 0, 0.2])
    for name in ("better", "paper"):
        arm = ArmModel("panda")
        controller = make_controller(name, arm, {})
        nothing = np.zeros(7)
        controller.step(Sensed(HOME, nothing, nothing, np.zeros(6)), 1e-3)
        effort = controller.step(Sensed(turned, nothing, nothing, np.zeros(6)), 1e-3)
        now = arm.snapshot(turned, nothing)
        accelerations[name] = float(now.J[5] @ now.M_inv @ (effort.torque - now.g))
    yaw = float(np.sign(now.J[5, 6])) * side
    assert accelerations["better"] * yaw < -1.0
    assert abs(accelerations["paper"]) < 0.1


@given(st.lists(st.floats(-60, 60), min_size=6, max_size=6).map(np.array), st.integers(0, 1000))
def test_a_wrist_at_its_limit_gives_up_a_moment_and_no_force(wrench: np.ndarray, seed: int) -> None:
    J = ArmModel("panda").snapshot(HOME + 0.2 * np.random.default_rng(seed).standard_normal(7), np.zeros(7)).J
    tau_max = np.array([87.0] * 4 + [12.0] * 3)
    tau = yield_moment(J.T @ wrench, J[3:], tau_max, (5,))
    assert abs(tau[5]) <= 12.0 + 1e-9
    rest, *_ = np.linalg.lstsq(J.T, tau, rcond=None)
    # Still the torque of a wrench (J^T has 6 columns for 7 joints), and its force is the wanted one.
    np.testing.assert_allclose(J.T @ rest, tau, atol=1e-7)
    np.testing.assert_allclose(rest[:3], wrench[:3], atol=1e-6)


def test_a_wrist_within_its_limits_is_left_alone() -> None:
    tau = np.array([80.0, -80.0, 10.0, 5.0, 11.9, -11.9, 0.0])
    J_w = np.random.default_rng(1).standard_normal((3, 7))
    np.testing.assert_array_equal(yield_moment(tau, J_w, np.array([87.0] * 4 + [12.0] * 3), (4, 5, 6)), tau)
