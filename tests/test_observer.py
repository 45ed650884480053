"""The leaky observer of momentum: what it feels is what pushes, however the arm moves and however time is cut."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from one_arm import HOME, arm

from agents.equations.observer import felt_torque, leaky, momentum_rate


def test_what_the_momentum_does_beyond_the_model_is_the_external_torque() -> None:
    """On a moving arm, by the derivative of M qd alone: a wrong sign of C^T qd, g or tau is off by newton metres."""
    rng = np.random.default_rng(1)
    h = 1e-5
    for _ in range(10):
        q, qd = HOME + 0.3 * rng.standard_normal(7), rng.standard_normal(7)
        tau, tau_ext = 20 * rng.standard_normal(7), 20 * rng.standard_normal(7)
        now = arm().snapshot(q, qd)
        qdd = now.M_inv @ (tau + tau_ext - now.C @ qd - now.g)
        before, after = (
            arm().snapshot(q + s * h * qd + 0.5 * h * h * qdd, qd + s * h * qdd).M @ (qd + s * h * qdd) for s in (-1, 1)
        )
        felt = felt_torque(after, before, momentum_rate(tau, now.C, qd, now.g), 2 * h)
        # Central differences: third derivatives of some 1e4 N m/s^2 times h^2, and rounding over h.
        np.testing.assert_allclose(felt, tau_ext, atol=1e-4)


@given(st.floats(0, 50), st.floats(0.1, 5), st.floats(0.01, 0.5), st.integers(1, 20))
def test_the_memory_is_that_of_the_differential_equation_however_time_is_cut(
    rate: float, leak: float, span_s: float, steps: int
) -> None:
    """ydot = rate (new - y) - leak y from 3 on, with new = 7: an exponential towards 7 rate / (rate + leak)."""
    y = np.array([3.0])
    for _ in range(steps):
        y = leaky(y, np.array([7.0]), rate / (rate + leak), exp(-(rate + leak) * span_s / steps))
    end = 7.0 * rate / (rate + leak)
    assert y[0] == pytest.approx(end + (3.0 - end) * exp(-(rate + leak) * span_s), rel=1e-9)


def test_two_arms_on_one_body_that_differ_settle_with_the_leak_and_wind_up_without() -> None:
    """Each takes over what it feels; one believes in half a newton that is not there."""
    for leak, settles in ((1.0, True), (0.0, False)):
        carried = np.array([50.0, 50.0])  # of a body of 100 N, held still
        for _ in range(20_000):
            felt = carried - np.mean(carried) + 50.0 + np.array([0.5, -0.5])  # the body takes from each what is over
            carried = leaky(carried, felt, 10.0 / (10.0 + leak), exp(-(10.0 + leak) * 1e-3))
        assert (abs(carried[0] - carried[1]) < 12.0) == settles
