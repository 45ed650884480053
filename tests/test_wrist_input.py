"""The base driven by the force at the wrist: what is felt is what pulls, weight and the hand's own inertia aside, and
a planar spring keeps the base with its hand."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from one_arm import HOME, OneArm, arm, sensed
from plants import QUIET, plant_of
from worlds import EXACT

from agents.controllers import make_controller
from agents.controllers.interface import Sensed
from agents.controllers.paper import PaperController
from agents.controllers.wrist_input import WristInput
from agents.errors import ControllerError
from sim_server.faults.pushes import Push
from sim_server.scenario import Scenario

Array = NDArray[np.float64]

WRENCH: dict[str, Any] = {"base_input": "wrench"}
K_ENV, T = 100.0, 0.05


# The filter


@given(st.lists(st.floats(1e-3, 0.1), min_size=1, max_size=20), st.floats(-50, 50), st.floats(-50, 50))
def test_a_steady_force_comes_up_with_the_named_time_constant_however_time_is_cut(
    steps: list[float], x: float, y: float
) -> None:
    felt, force = WristInput(K_ENV, T), np.array([x, y])
    for dt_s in steps:
        e, _ = felt.step(-force, np.zeros(2), dt_s)  # the arm holds against the pull
    share = 1.0 - np.exp(-sum(steps) / T)
    np.testing.assert_allclose(e, share * force / K_ENV, rtol=1e-9, atol=1e-12)


def test_what_accelerates_the_hand_is_not_taken_for_the_arms_push() -> None:
    """A hand of 0.76 kg that is accelerated steadily by the load's 3 N, of which the arm takes 2 N back."""
    felt = WristInput(K_ENV, T)
    mass, pull, back = 0.76, np.array([3.0, 0.0]), np.array([-2.0, 0.0])
    for tick in range(1000):
        velocity = (pull + back) / mass * 1e-3 * tick
        e, _ = felt.step(back, mass * velocity, 1e-3)
    # The filter goes in steps: half a step of 1 ms in 50 ms is one per cent of the inertia's part.
    np.testing.assert_allclose(e * K_ENV, pull, rtol=0, atol=0.02)


def test_the_estimate_begins_at_zero_even_in_motion() -> None:
    e, _ = WristInput(K_ENV, T).step(np.zeros(2), np.array([5.0, -3.0]), 1e-9)
    np.testing.assert_allclose(e, np.zeros(2), rtol=0, atol=1e-6)


def test_noise_is_taken_down_by_the_filter() -> None:
    """White noise through a low-pass of T = 50 ms at 1 kHz: sqrt(dt / 2 T) = a tenth is left."""
    felt, rng = WristInput(K_ENV, T), np.random.default_rng(1)
    left = [felt.step(0.2 * rng.standard_normal(2), np.zeros(2), 1e-3)[0] * K_ENV for _ in range(20_000)]
    assert np.std(left) == pytest.approx(0.02, rel=0.1)


# The law


def driven(q: Array, wrench: Array, steps: int = 1000) -> Array:
    """The base force after so many steps of 1 ms at rest."""
    law = PaperController(arm(), **WRENCH)
    zero = np.zeros(7)
    for _ in range(steps):
        effort = law.step(Sensed(q, zero, zero, wrench), 1e-3)
    return effort.base_force


def test_the_base_goes_where_the_load_pulls_by_k_m_over_k_env() -> None:
    """The hand hangs straight down, its x axis ahead: the wrist's y and z point right and down."""
    weight = 60.0  # of hand and load: no part of it is in the plane
    np.testing.assert_allclose(driven(HOME, np.zeros(6)), np.zeros(3), rtol=0, atol=1e-12)
    pulled_ahead = np.array([-5.0, 0.0, -weight, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(driven(HOME, pulled_ahead), [2000.0 / 100.0 * 5.0, 0.0, 0.0], rtol=0, atol=1e-6)
    pulled_left = np.array([0.0, 5.0, -weight, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(driven(HOME, pulled_left), [0.0, 100.0, 0.0], rtol=0, atol=1e-6)


def test_a_turned_hand_feels_the_same_pull() -> None:
    """The wrist is turned by 1 rad about the vertical: its axes turn, the pull does not."""
    turned = HOME + np.array([0, 0, 0, 0, 0, 0, 1.0])
    R_BW = arm().snapshot(turned, np.zeros(7)).R_BE @ arm().beyond_the_wrist().R_EW
    wrench = np.concatenate([R_BW.T @ [-5.0, 2.0, 40.0], np.zeros(3)])
    np.testing.assert_allclose(driven(turned, wrench), [100.0, -40.0, 0.0], rtol=0, atol=1e-6)


def test_the_hand_beyond_the_wrist_is_that_of_mujoco() -> None:
    """By the subtree of the hand's body in the same description."""
    plant, hand = OneArm(), arm().beyond_the_wrist()
    model, data = plant.model, plant.data
    body, tcp = model.body("hand").id, data.site("tcp")
    assert hand.mass == pytest.approx(model.body_subtreemass[body], abs=1e-12)
    R_WE = tcp.xmat.reshape(3, 3)
    np.testing.assert_allclose(tcp.xpos + R_WE @ hand.p_EC, data.subtree_com[body], rtol=0, atol=1e-12)
    np.testing.assert_allclose(R_WE @ hand.R_EW, data.site("wrist").xmat.reshape(3, 3), rtol=0, atol=1e-12)


def test_the_planar_spring_draws_the_hand_back_and_leaves_the_task_alone() -> None:
    """By MuJoCo's acceleration, against the same law without the spring."""
    q = HOME + np.array([0.1, 0, 0, 0, 0, 0, 0.1])  # round the base: 5 cm to the left, at the same height
    found = []
    for gains in ({}, WRENCH):
        law = PaperController(arm(), **gains)
        law.step(sensed(HOME), 1e-3)
        plant = OneArm()
        plant.data.qpos[:] = q
        plant.data.qfrc_applied[:] = law.step(sensed(q), 1e-3).torque
        mujoco.mj_forward(plant.model, plant.data)
        found.append(arm().snapshot(q, np.zeros(7)).J @ plant.data.qacc)
    change = found[1] - found[0]
    shift = (arm().snapshot(q, np.zeros(7)).p_BE - arm().snapshot(HOME, np.zeros(7)).p_BE)[:2]
    assert np.hypot(*shift) == pytest.approx(0.05, abs=0.01)
    np.testing.assert_allclose(change[2:5], np.zeros(3), rtol=0, atol=1e-8)
    assert change[:2] @ shift < -0.1 * np.hypot(*shift)


def test_a_push_on_a_hand_is_felt_as_it_is_and_moves_it_by_its_size_over_k_env() -> None:
    """The whole chain: MuJoCo's wrist sensor, an arm on a stand, a steady push on its hand."""
    block = {"shape": "block", "size_m": [0.05] * 3, "mass_kg": 0.1, "struts": 1}
    given_ = Scenario.model_validate(
        {
            "description": "test",
            "team": {"count": 1},
            "load": block,
            "base": {"fixed": True},
            "plant": {**EXACT, **QUIET},
        }
    )
    k_env = 400.0  # stiffer than by default, so that the hand's damping lets it arrive within seconds
    plant, law = plant_of(given_), PaperController(arm(), **WRENCH, environment_stiffness_N_m=k_env)
    start, force = plant.load_pose().position.copy(), np.array([3.0, -2.0, 0.0])
    for tick in range(6000):
        reading = plant.read()["a1"]
        effort = law.step(
            Sensed(*(np.array(each) for each in (reading.q, reading.qd, reading.tau, reading.wrench))), 1e-3
        )
        plant.command("a1", effort.torque, effort.base_force, effort.stiffness)
        if tick == 0:
            plant.push(Push(at_s=0, kind="push", arm="a1", for_s=9.0, force_N=(3.0, -2.0, 0.0)))
        plant.step()
    np.testing.assert_allclose(effort.base_force[:2], 2000.0 / k_env * force[:2], rtol=0, atol=0.25)  # 0.05 N
    moved = plant.load_pose().position - start
    np.testing.assert_allclose(moved[:2], force[:2] / k_env, rtol=0, atol=5e-4)


def test_driven_by_displacement_the_law_has_no_input_for_the_wrist() -> None:
    law = PaperController(arm())
    assert "wrist_force" not in law._law.inputs
    heavy = Sensed(HOME, np.zeros(7), np.zeros(7), np.full(6, 50.0))
    np.testing.assert_array_equal(law.step(heavy, 1e-3).base_force, np.zeros(3))


@pytest.mark.parametrize(
    ("gains", "said"),
    [
        ({"base_input": "force"}, ("gain base_input", "'displacement' or 'wrench'", "'force'")),
        ({"environment_stiffness_N_m": 0.0}, ("gain environment_stiffness_N_m", "greater than 0")),
        ({"wrench_filter_s": -1.0}, ("gain wrench_filter_s", "greater than 0")),
    ],
)
def test_an_input_that_cannot_be_is_refused_with_its_key(gains: dict[str, Any], said: tuple[str, ...]) -> None:
    with pytest.raises(ControllerError) as error:
        make_controller("paper", arm(), gains)
    for words in said:
        assert words in str(error.value)
