"""Traced functions against the same functions run by numpy, and the paper's law both ways."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.controllers.interface import Sensed
from agents.controllers.paper import PaperController, PaperGains, paper_law
from agents.tracing import Traced

Array = NDArray[np.float64]

REORDERED = 1e-10
"""Relative: the same sums in another order, through an inverse of condition 1e3."""


@cache
def arm() -> ArmModel:
    return ArmModel("panda")


def every_operation(a: Array, b: Array, S: Array) -> tuple[Array, Array]:
    """All that a symbol can do, from both sides."""
    return 1.0 + a - 2.0 * b / 3.0 + np.abs(a - b) ** 2 - a * b, 5.0 - S @ a / (4.0 + b * b) - (
        3.0 / (a * a + 1.0)
    ) + -a + np.sin(a) * np.cos(b) + np.sqrt(a * a + 1.0)


@given(st.lists(st.floats(-10, 10), min_size=12, max_size=12))
def test_a_traced_function_is_the_function(numbers: list[float]) -> None:
    a, b, half = np.array(numbers[:3]), np.array(numbers[3:6]), np.array(numbers[3:]).reshape(3, 3)
    S = half + half.T
    traced = Traced(every_operation, {"a": (3,), "b": (3,), "S": (3, 3)})
    traced.inputs["a"][:], traced.inputs["b"][:] = a, b
    traced.inputs["S"][:] = S
    traced()
    for found, wanted in zip(traced.outputs, every_operation(a, b, S), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)


def test_inputs_of_two_dimensions_keep_their_rows_and_columns() -> None:
    traced = Traced(lambda A: (A[0], A[:, 1]), {"A": (2, 3)})
    traced.inputs["A"][:] = [[1, 2, 3], [4, 5, 6]]
    traced()
    np.testing.assert_array_equal(traced.outputs[0], [1, 2, 3])
    np.testing.assert_array_equal(traced.outputs[1], [2, 5])


def test_a_result_that_depends_on_nothing_stays_a_number() -> None:
    traced = Traced(lambda a: (a, np.array([7.0, 8.0])), {"a": (1,)})
    traced()
    np.testing.assert_array_equal(traced.outputs[1], [7.0, 8.0])


def test_what_was_done_before_is_not_done_again() -> None:
    def often(a: Array, b: Array) -> tuple[Array]:
        return (a * b + b * a + (-a) * b - a * (-b) + np.sin(a) * np.sin(a) + 0.0 * b + 1.0 * a,)

    traced = Traced(often, {"a": (1,), "b": (1,)})
    traced.inputs["a"][:], traced.inputs["b"][:] = 3.0, 5.0
    traced()
    assert traced.outputs[0][0] == pytest.approx(30.0 + np.sin(3.0) ** 2 + 3.0, rel=1e-15)
    # Two inputs, a b, its double, the two that take it off and put it back, sin a, its square, two sums, one output.
    assert traced.operations <= 11


def test_a_function_of_numpy_that_symbols_do_not_have_is_an_error_and_not_a_wrong_number() -> None:
    with pytest.raises(TypeError, match="no callable tan method"):
        Traced(lambda a: (np.tan(a),), {"a": (2, 2)})


def test_a_choice_by_a_symbols_value_is_an_error_and_not_a_wrong_number() -> None:
    with pytest.raises(TypeError, match="not supported between instances of 'Symbol' and 'int'"):
        Traced(lambda a: (np.where(a > 0, a, -a),), {"a": (2, 2)})


def test_linear_algebra_of_symbols_is_an_error_and_not_a_wrong_number() -> None:
    with pytest.raises(TypeError, match="Cannot cast ufunc 'inv'"):
        Traced(lambda a: (np.linalg.inv(a),), {"a": (2, 2)})


GAINS: list[dict[str, Any]] = [
    {},
    {"adaptive": False},
    {"drift_compensation": False},
    {"observer": False},
    {"alpha": 1.0, "beta": 3.0},
    {"null_restoring": False, "yaw_stiffness_Nm_rad": 60.0, "yaw_damping_Nms_rad": 10.0},
]


@pytest.mark.parametrize("gains", GAINS, ids=str)
def test_the_traced_law_is_the_law(gains: dict[str, Any]) -> None:
    """The controller, traced and filled in place, against the same equations run by numpy on a snapshot."""
    rng = np.random.default_rng(1)
    law = partial(paper_law, PaperGains.model_validate(gains))
    for _ in range(20):
        controller = PaperController(arm(), **gains)
        home = np.array([0.0, -0.1, 0.0, -2.1, 0.0, 2.0, 0.8]) + 0.3 * rng.standard_normal(7)
        controller.step(Sensed(home, np.zeros(7), np.zeros(7), np.zeros(6)), 1e-3)
        held = arm().snapshot(home, np.zeros(7))
        q, qd = home + 0.05 * rng.standard_normal(7), rng.standard_normal(7)
        effort = controller.step(Sensed(q, qd, np.zeros(7), np.zeros(6)), 1e-3)
        now = arm().snapshot(q, qd)
        torque, base_force, stiffness = law(
            qd=qd, M_inv=now.M_inv, C=now.C, g=now.g, J=now.J, Jdot=now.Jdot, p_BE=now.p_BE, R_BE=now.R_BE,
            p_held=held.p_BE, up_E=held.R_BE[2], ahead_held=held.R_BE[:, 0],
        )  # fmt: skip
        np.testing.assert_allclose(effort.torque, torque, rtol=REORDERED, atol=REORDERED * np.abs(torque).max())
        np.testing.assert_allclose(effort.base_force, base_force, rtol=REORDERED, atol=1e-9)
        np.testing.assert_allclose(effort.stiffness, stiffness, rtol=REORDERED)


def test_two_controllers_on_one_arm_do_not_share_memory() -> None:
    first, second = PaperController(arm()), PaperController(arm())
    q = np.array([0.0, -0.1, 0.0, -2.1, 0.0, 2.0, 0.8])
    still = Sensed(q, np.zeros(7), np.zeros(7), np.zeros(6))
    effort = first.step(still, 1e-3)
    torque = effort.torque.copy()
    second.step(Sensed(q + 0.1, np.ones(7), np.zeros(7), np.zeros(6)), 1e-3)
    first.step(Sensed(q - 0.1, np.ones(7), np.zeros(7), np.zeros(6)), 1e-3)
    np.testing.assert_array_equal(effort.torque, torque)
