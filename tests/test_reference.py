"""A predefined trajectory of the task: its derivatives, what equation 6 makes of it, and how an arm follows it."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from one_arm import HOME, OneArm, arm, sensed

from agents.controllers import make_controller
from agents.controllers.paper import PaperController, PaperGains
from agents.equations.reference import ramp_share, sine_reference, tilted_axis
from agents.errors import ControllerError

Array = NDArray[np.float64]

SINE: dict[str, Any] = {"reference": "sine"}
TILTING: dict[str, Any] = {
    **SINE,
    "reference_height_m": 0.05,
    "reference_roll_rad": 0.1,
    "reference_pitch_rad": -0.15,
    "reference_ramp_s": 1.0,
}

times = st.floats(0.01, 30.0)
frequencies = st.floats(0.05, 2.0)
ramps = st.one_of(st.just(0.0), st.floats(0.1, 10.0))


def swings(f: float, ramp: float, t: float) -> tuple[float, float, float]:
    return sine_reference(f, ramp, t, ramp_share(t, ramp))


@given(times, frequencies, ramps)
def test_the_rates_of_the_reference_are_its_derivatives(t: float, f: float, ramp: float) -> None:
    h = 1e-4
    before, now, after = (swings(f, ramp, t + s) for s in (-h, 0.0, h))
    if abs(t - ramp) < 2 * h:
        return  # the third derivative jumps where the ramp ends
    # A central difference is off by h^2 / 6 of the third derivative: up to 1e5 1/s^3 within a ramp of 0.1 s.
    assert (after[0] - before[0]) / (2 * h) == pytest.approx(now[1], rel=0, abs=1e-3)
    assert (after[1] - before[1]) / (2 * h) == pytest.approx(now[2], rel=0, abs=0.1)


@given(frequencies, st.floats(0.1, 10.0))
def test_the_reference_begins_at_rest_and_its_ramp_ends_without_a_jump(f: float, ramp: float) -> None:
    assert swings(f, ramp, 0.0) == (0.0, 0.0, 0.0)
    before, after = (swings(f, ramp, ramp * (1.0 + s)) for s in (-1e-9, 1e-9))
    np.testing.assert_allclose(before, after, rtol=0, atol=1e-4)  # of up to 158 1/s^2 at 2 Hz


def test_after_its_ramp_the_reference_is_the_sine_that_is_told_of() -> None:
    gains = PaperGains(**SINE)
    for t in (4.0, 5.0, 7.3):
        x_d, xd_d, xdd_d = gains.reference_at(t)
        w = 2 * np.pi * 0.25
        np.testing.assert_allclose(x_d, [0.1 * np.sin(w * t), 0.0, 0.0], rtol=0, atol=1e-15)
        np.testing.assert_allclose(xd_d, [0.1 * w * np.cos(w * t), 0.0, 0.0], rtol=0, atol=1e-15)
        np.testing.assert_allclose(xdd_d, [-0.1 * w * w * np.sin(w * t), 0.0, 0.0], rtol=0, atol=1e-15)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_the_tilted_axis_is_the_upright_one_turned_about_the_roll_and_pitch_vector(roll: float, pitch: float) -> None:
    quat, turned = np.zeros(4), np.zeros(3)
    angle = np.hypot(roll, pitch)
    mujoco.mju_axisAngle2Quat(quat, np.array([roll, pitch, 0.0]) / angle if angle else np.array([1.0, 0, 0]), angle)
    mujoco.mju_rotVecQuat(turned, np.array([0.0, 0.0, 1.0]), quat)
    for swing in (1.0, -1.0):
        np.testing.assert_allclose(tilted_axis(swing * roll, swing * pitch, swing), turned, rtol=0, atol=1e-12)


def axis_at(gains: PaperGains, t: float) -> Array:
    _, roll, pitch = gains.reference_at(t)[0]
    return tilted_axis(roll, pitch, 1.0)


def test_the_axis_moves_with_the_task_velocity_that_goes_with_it() -> None:
    """d/dt u_d = w x u_d, with w = (roll rate, pitch rate, 0)."""
    gains, h = PaperGains(**TILTING), 1e-6
    for t in np.linspace(0.1, 4.0, 14):
        before, here, after = (axis_at(gains, t + s) for s in (-h, 0.0, h))
        rate = (after - before) / (2 * h)
        _, roll_rate, pitch_rate = gains.reference_at(t)[1]
        np.testing.assert_allclose(rate, np.cross([roll_rate, pitch_rate, 0.0], here), atol=1e-9)


# What the law makes of it.


@pytest.mark.parametrize("gains", [SINE, TILTING])
def test_task_accelerates_as_equation_6_says_with_a_reference(gains: dict[str, Any]) -> None:
    """xdd = xdd_d + B_e (xd_d - xd) + K_e x_err + what the observer adds, by MuJoCo's acceleration."""
    rng = np.random.default_rng(41)
    start = arm().snapshot(HOME, np.zeros(7))
    for t in (0.3, 1.7, 4.4):
        q, qd = HOME + rng.uniform(-0.05, 0.05, 7), rng.uniform(-1, 1, 7)
        law = PaperController(arm(), **gains)
        law.step(sensed(HOME), 1e-3)
        effort = law.step(sensed(q, qd), t)
        plant = OneArm()
        plant.data.qpos[:], plant.data.qvel[:], plant.data.qfrc_applied[:] = q, qd, effort.torque
        mujoco.mj_forward(plant.model, plant.data)
        now = arm().snapshot(q, qd)
        J = now.J[2:5]
        x_d, xd_d, xdd_d = PaperGains(**gains).reference_at(t)
        up = now.R_BE @ start.R_BE.T @ np.array([0, 0, 1.0])
        turn = np.cross(up, tilted_axis(x_d[1], x_d[2], 1.0))
        x_err = np.array([start.p_BE[2] + x_d[0] - now.p_BE[2], turn[0], turn[1]])
        Jbar = now.M_inv @ J.T @ np.linalg.inv(J @ now.M_inv @ J.T)
        observed = J @ now.M_inv @ J.T @ Jbar.T @ (effort.stiffness * (Jbar @ x_err))
        wanted = xdd_d + 1.0 * (xd_d - J @ qd) + 80.0 * x_err + observed
        np.testing.assert_allclose(J @ plant.data.qacc + now.Jdot[2:5] @ qd, wanted, rtol=0, atol=1e-8)


def follow(seconds: float, mass_kg: float, **gains: Any) -> tuple[Array, Array, Array]:
    """An arm that takes over at rest: height and tilt errors over time, (ticks,) m and rad, and the sum of |torque|."""
    plant, law = OneArm(mass_kg), PaperController(arm(), **gains)
    plant.data.qfrc_applied[:] = plant.data.qfrc_bias
    start, errors, tilts, torques = plant.height, [], [], []
    for tick in range(round(1000 * seconds)):
        x_d, _, _ = law.gains.reference_at(1e-3 * tick)
        errors.append(start + x_d[0] - plant.height)
        hand = -plant.data.site("tcp").xmat.reshape(3, 3)[:, 2]
        tilts.append(np.linalg.norm(np.cross(hand, tilted_axis(x_d[1], x_d[2], 1.0))))
        effort = law.step(plant.sense(), 1e-3)
        torques.append(np.abs(effort.torque).sum())
        plant.apply(effort)
    return np.array(errors), np.array(tilts), np.array(torques)


@pytest.mark.parametrize("gains", [SINE, TILTING])
def test_an_arm_that_knows_its_load_stays_on_the_reference(gains: dict[str, Any]) -> None:
    """By the feed-forward alone: the error stays within what one step of 1 ms is late."""
    errors, tilts, _ = follow(5.0, 0.0, **gains)
    assert np.abs(errors).max() < 2e-4  # the speed is 0.16 m/s at most
    assert tilts.max() < 5e-4


def test_adaptive_stiffness_follows_better_with_an_unknown_mass_by_nearly_the_same_torque() -> None:
    """Section VI-B, on an ideal arm: 2.5 kg, the second period. Measured: rms height error 19.8 -> 12.8 mm, rms tilt
    2.7 -> 1.8 deg; the sum of all |torque| is 77.4 and 78.2 N m on average, nearly all of it weight."""
    (fixed, fixed_tilt, fixed_torque), (adaptive, adaptive_tilt, adaptive_torque) = (
        [part[4000:] for part in follow(8.0, 2.5, adaptive=on, **SINE)] for on in (False, True)
    )
    assert rms(adaptive) < 0.7 * rms(fixed)
    assert rms(adaptive_tilt) < rms(fixed_tilt)
    assert adaptive_torque.mean() == pytest.approx(fixed_torque.mean(), rel=0.02)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_reference_goes_by_the_steps_that_the_law_is_told_of() -> None:
    """However the time is cut into steps; the first step is take-over, whatever time it is told."""
    efforts = []
    for cuts in ([2.0], [0.5, 0.5, 1.0], [0.25] * 8):
        law = PaperController(arm(), **TILTING)
        law.step(sensed(HOME), 123.0)
        for dt_s in cuts:
            effort = law.step(sensed(HOME), dt_s)
        efforts.append(effort.torque)
    for one, other in pairwise(efforts):
        np.testing.assert_array_equal(one, other)


def test_without_a_reference_the_law_has_no_inputs_for_it_and_does_the_same_arithmetic() -> None:
    plain, followed = PaperController(arm()), PaperController(arm(), **SINE)
    assert plain._law.inputs.keys() == {"q", "qd", "p_held", "up_E", "ahead_held"}
    assert plain._law.operations < followed._law.operations < plain._law.operations + 60
    np.testing.assert_array_equal(PaperGains().reference_at(3.0), np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("gains", "said"),
    [
        ({"reference": "cosine"}, ("gain reference", "'none' or 'sine'", "'cosine'", "reference_height_m")),
        ({"reference_frequency_Hz": 0.0}, ("gain reference_frequency_Hz", "greater than 0")),
        ({"reference_height_m": float("nan")}, ("gain reference_height_m", "finite")),
        ({"reference_heigth_m": 0.1}, ("gain reference_heigth_m",)),
    ],
)
def test_a_reference_that_cannot_be_is_refused_with_its_key(gains: dict[str, Any], said: tuple[str, ...]) -> None:
    with pytest.raises(ControllerError) as error:
        make_controller("paper", arm(), gains)
    for words in said:
        assert words in str(error.value)
