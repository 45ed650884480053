"""Springs that stiffen, dampers that go with them, and their balance of power."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from one_arm import HOME, arm

from agents.controllers.palanquin import TASK_ROWS, least_stiffness
from agents.controllers.palanquin_gains import PalanquinGains
from agents.equations.bounds import limited
from agents.equations.impedance import (
    damping,
    damping_power,
    spring_force,
    stability_margin,
    stiffening,
    stiffness_power,
    stiffness_step,
)
from agents.equations.task import task_inertia

Array = NDArray[np.float64]


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(0, 1e4))
def test_a_bound_is_a_bound(x: float, low: float, width: float) -> None:
    assert limited(x, low, low + width) == pytest.approx(min(max(x, low), low + width), abs=1e-11)


def test_the_stiffness_goes_from_least_to_most_by_the_square_of_the_error() -> None:
    least, most, soft = np.array([10.0]), np.array([30.0]), np.array([0.1])
    for err, wanted in ((0.0, 10.0), (0.1, 20.0), (-0.1, 20.0), (0.2, 10.0 + 20.0 * 4 / 5), (1e6, 30.0)):
        assert stiffening(least, most, np.array([err]), soft)[0] == pytest.approx(wanted)


def test_a_step_of_the_stiffness_is_bounded_both_ways_and_arrives() -> None:
    K = np.array([100.0, 100.0, 100.0])
    wanted = np.array([1000.0, 1.0, 105.0])
    np.testing.assert_allclose(stiffness_step(K, wanted, 1.25), [125.0, 80.0, 105.0])


def test_a_mass_on_such_a_spring_and_damper_comes_back_as_solved_by_hand() -> None:
    """zeta = 1: x(t) = x0 (1 + w t) exp(-w t), w = sqrt(K / m)."""
    K, m, w = np.array([800.0]), np.array([[2.0]]), 20.0
    D = damping(K, m, 1.0)
    x, v, h = np.array([0.01]), np.array([0.0]), 1e-5
    for _ in range(10_000):
        v = v + h * spring_force(K, -x, D, v) / m[0]
        x = x + h * v
    assert x[0] == pytest.approx(0.01 * (1 + w * 0.1) * np.exp(-w * 0.1), rel=1e-3)  # steps of first order


@given(st.lists(st.floats(-2, 2), min_size=15, max_size=15).map(np.array))
def test_energy_changes_by_what_stiffening_puts_in_and_damping_takes_out(numbers: Array) -> None:
    x, v, K, K_rate, D = numbers.reshape(5, 3)
    K, D, m = K + 3, D + 3, np.array([1.0, 2.0, 3.0])
    a = spring_force(K, -x, D, v) / m

    def energy(t: float) -> float:
        there, speed = x + t * v + 0.5 * t * t * a, v + t * a
        return float(0.5 * m @ speed**2 + 0.5 * (K + t * K_rate) @ there**2)

    change = (energy(1e-4) - energy(-1e-4)) / 2e-4
    assert change == pytest.approx(stiffness_power(K_rate, x) - damping_power(D, v), abs=1e-5)


@given(st.floats(0, 1), st.floats(0, 1), st.floats(-1, 1), st.integers(0, 100))
def test_the_presets_bound_on_stiffening_keeps_a_hand_with_its_load_stable(
    lift: float, tilt: float, rate: float, seed: int
) -> None:
    """Kronander and Billard, at any stiffness and rate that the gains allow, with 10 kg and 0.5 kg m^2 in the hand."""
    gains = PalanquinGains()
    J = arm().snapshot(HOME + 0.1 * np.random.default_rng(seed).standard_normal(7), np.zeros(7))
    Lambda = task_inertia(J.J[TASK_ROWS], J.M_inv)
    K = least_stiffness(gains) * (1.0 + gains.stiffen * np.array([lift, tilt, tilt]))
    K_rate = rate * gains.stiffness_rate_1_s * K
    D = damping(K, Lambda, gains.damping_ratio)
    alpha = float(np.min(D / (np.diag(Lambda) + np.array([10.0, 0.5, 0.5]))))
    assert stability_margin(K, K_rate, D, 0.5 * K_rate / K * D, alpha).min() >= 0.0
