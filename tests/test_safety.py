"""What stands between a law and the wire: usable efforts only, within the arm's limits, handed over smoothly."""

from __future__ import annotations

from typing import cast

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from one_arm import HOME, OneArm, arm, sensed

from agents.controllers.interface import Controller, Effort, Sensed
from agents.controllers.paper import PaperController
from agents.errors import ControllerError
from agents.safety import SafeController, hold_effort

Array = NDArray[np.float64]


TORQUE_MAX = np.array([87.0] * 4 + [12.0] * 3)


# What stands between a law and the wire.


class Says:
    """A law that always says the same."""

    def __init__(self, effort: Effort) -> None:
        self.effort = effort

    def step(self, sensed: Sensed, dt_s: float) -> Effort:
        return self.effort


def says(torque: Array, base: Array | None = None, stiffness: Array | None = None) -> Controller:
    return Says(Effort(torque, np.zeros(3) if base is None else base, np.zeros(7) if stiffness is None else stiffness))


@pytest.mark.parametrize(
    ("law", "what"),
    [
        (says(np.zeros(6)), r"torque: got ndarray of shape \(6,\), expected a numpy array of shape \(7,\)"),
        (says(np.zeros((7, 1))), r"torque: got ndarray of shape \(7, 1\), expected a numpy array of shape \(7,\)"),
        (
            says(np.zeros(7), np.zeros(2)),
            r"base_force: got ndarray of shape \(2,\), expected a numpy array of shape \(3,\)",
        ),
        (
            says(np.zeros(7), stiffness=np.zeros(8)),
            r"stiffness: got ndarray of shape \(8,\), expected a numpy array of shape \(7,\)",
        ),
        (says(cast(Array, [0.0] * 7)), r"torque: got list, expected a numpy array of shape \(7,\)"),
        (says(np.array(["1"] * 7)), "torque: got an array of <U1, expected one of real numbers"),
        (says(np.zeros(7, dtype=complex)), "torque: got an array of complex128, expected one of real numbers"),
        (says(np.array([None] * 7)), "torque: got an array of object, expected one of real numbers"),
        (says(np.array([0, 0, np.nan, 0, 0, 0, 0])), "torque: got .*nan.*, expected finite"),
        (says(np.array([0, 0, np.inf, 0, 0, 0, 0])), "torque: got .*inf.*, expected finite"),
        (says(np.zeros(7), np.array([0, -np.inf, 0])), "base_force: got .*inf.*, expected finite"),
        (says(np.zeros(7), stiffness=np.full(7, np.nan)), "stiffness: got .*nan.*, expected finite"),
    ],
)
def test_a_law_that_returns_what_cannot_be_used_is_stopped(law: Controller, what: str) -> None:
    with pytest.raises(ControllerError, match=f"controller mine: {what}"):
        SafeController("mine", law, arm(), 1.0).step(sensed(HOME), 1e-3)


def test_a_law_that_forgets_to_return_is_told_so() -> None:
    class Forgetful:
        def step(self, sensed: Sensed, dt_s: float) -> Effort:
            return cast(Effort, None)

    with pytest.raises(ControllerError, match="controller mine: step: got NoneType, expected an Effort"):
        SafeController("mine", Forgetful(), arm(), 1.0).step(sensed(HOME), 1e-3)


def test_torque_stays_within_the_arms_limits() -> None:
    wanted = np.array([500.0, -500.0, 50.0, -50.0, 13.0, -500.0, 11.0])
    safe = SafeController("mine", says(wanted), arm(), 0.0)
    effort = safe.step(sensed(HOME), 1e-3)
    np.testing.assert_array_equal(effort.torque, [87.0, -87.0, 50.0, -50.0, 12.0, -12.0, 11.0])


def test_taking_over_begins_with_the_torque_that_is_there_and_ends_with_the_laws() -> None:
    there, wanted, base = np.linspace(-10, 10, 7), np.linspace(5, 11, 7), np.array([1.0, 2.0, 3.0])
    safe = SafeController("mine", says(wanted, base, np.ones(7)), arm(), handover_s=0.1)
    torques = []
    for _ in range(101):
        effort = safe.step(sensed(HOME, tau=there), 1e-3)
        torques.append(effort.torque)
        np.testing.assert_array_equal(effort.base_force, base)  # only the torque is handed over
        np.testing.assert_array_equal(effort.stiffness, np.ones(7))
    np.testing.assert_allclose(torques[0], there, rtol=0, atol=1e-14)
    np.testing.assert_allclose(torques[50], (there + wanted) / 2, rtol=0, atol=1e-12)  # half-way at half-time
    np.testing.assert_allclose(torques[100], wanted, rtol=0, atol=1e-14)
    share = (torques - wanted)[:, 0] / (there - wanted)[0]
    assert np.all(np.diff(share) < 0)
    # Smooth: the steepest slope of 1 - 3 s^2 + 2 s^3 is 1.5 per handover_s, and it begins and ends flat.
    assert np.diff(share).min() > -1.5 * 1e-3 / 0.1 - 1e-12
    assert np.abs(np.diff(share)[[0, -1]]).max() < 4e-4


def test_the_torque_at_take_over_is_kept_though_the_law_changes_its_mind_later() -> None:
    """What is added is fixed at the first step: a law that then reacts is not held back."""
    law = Says(Effort(np.full(7, 1.0), np.zeros(3), np.zeros(7)))
    safe = SafeController("mine", law, arm(), handover_s=1.0)
    safe.step(sensed(HOME, tau=np.full(7, 4.0)), 1e-3)
    law.effort = Effort(np.full(7, 3.0), np.zeros(3), np.zeros(7))
    # 3 and nearly all of the 4 - 1 that the law did not know of; 3e-6 of it has faded after 1 ms.
    np.testing.assert_allclose(safe.step(sensed(HOME), 1e-3).torque, np.full(7, 6.0), rtol=0, atol=1e-5)


def test_taking_over_from_more_than_the_arm_may_give_begins_at_its_limit() -> None:
    safe = SafeController("mine", says(np.zeros(7)), arm(), handover_s=1.0)
    np.testing.assert_array_equal(safe.step(sensed(HOME, tau=np.full(7, 100.0)), 1e-3).torque, TORQUE_MAX)


def test_without_a_handover_the_law_has_the_arm_at_once() -> None:
    safe = SafeController("mine", says(np.ones(7)), arm(), handover_s=0.0)
    for _ in range(2):
        np.testing.assert_array_equal(safe.step(sensed(HOME, tau=np.full(7, 5.0)), 1e-3).torque, np.ones(7))


def test_an_arm_that_carried_its_load_before_does_not_sink_at_take_over() -> None:
    """2.5 kg that the arm holds already: in the first tenth of a handover of 1 s the hand sinks less than a hundredth
    of what it does without one."""

    def sunk(handover_s: float) -> float:
        plant = OneArm(2.5)
        start = plant.height
        plant.data.qfrc_applied[:] = plant.data.qfrc_bias  # all of the weight, the mass included
        safe = SafeController("paper", PaperController(arm()), arm(), handover_s)
        for _ in range(100):
            plant.apply(safe.step(plant.sense(), 1e-3))
        return start - plant.height

    assert 0 < 100 * sunk(1.0) < sunk(0.0)  # 0.068 and 13.1 mm measured


@pytest.mark.parametrize("q", [HOME, HOME + 0.2])
def test_the_hold_effort_is_gravity_alone(q: Array) -> None:
    plant = OneArm()
    plant.data.qpos[:] = q
    mujoco.mj_forward(plant.model, plant.data)
    effort = hold_effort(arm(), q)
    np.testing.assert_allclose(effort.torque, plant.data.qfrc_bias, rtol=0, atol=1e-11)  # two recursions, up to 100 N m
    np.testing.assert_array_equal(effort.base_force, np.zeros(3))
    np.testing.assert_array_equal(effort.stiffness, np.zeros(7))
