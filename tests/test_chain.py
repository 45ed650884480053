"""The arm's terms as the law computes them, against Pinocchio's, which tests/test_arm_model.py holds to MuJoCo."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from agents import arm_model
from agents.arm_model import ArmModel
from agents.equations.chain import (
    chain_terms,
    coriolis_factor,
    inverse_of_inertia,
    motion_cross,
    spatial_inertia,
    turned,
)
from agents.errors import AgentError
from agents.tracing import Traced
from wire.arms import arm_path

Array = NDArray[np.float64]

NAMES = ("M", "C", "g", "J", "Jdot", "p_BE", "R_BE")
ROUNDING = 1e-12
"""Two ways through seven joints with numbers of the order of 1 to 100, each rounded to 2e-16."""


@cache
def arm() -> ArmModel:
    return ArmModel("panda")


def states() -> list[tuple[Array, Array]]:
    """Postures over the whole joint range, speeds up to about each joint's limit."""
    low, high = mujoco.MjModel.from_xml_path(str(arm_path("panda"))).jnt_range.T
    rng = np.random.default_rng(4)
    return [(rng.uniform(low, high), rng.uniform(-2.0, 2.0, 7)) for _ in range(50)]


@pytest.mark.parametrize("name", NAMES)
def test_the_terms_of_the_chain_are_pinocchios(name: str) -> None:
    for q, qd in states():
        ours, theirs = chain_terms(arm().chain, q, qd), arm().snapshot(q, qd)
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=0, atol=ROUNDING)


def test_the_inverse_of_the_inertia_is_its_inverse() -> None:
    for q, qd in states():
        M = chain_terms(arm().chain, q, qd).M
        # Rotors of 0.1 kg m^2 keep the condition number of M below 100.
        np.testing.assert_allclose(inverse_of_inertia(M) @ M, np.eye(7), rtol=0, atol=100 * ROUNDING)


def test_the_compiled_terms_are_the_terms() -> None:
    """The same functions on numbers and on symbols; what is compiled does what is written."""

    def terms(q: Array, qd: Array) -> tuple[Array, ...]:
        now = chain_terms(arm().chain, q, qd)
        return (*(getattr(now, name).ravel() for name in NAMES), inverse_of_inertia(now.M).ravel())

    compiled = Traced(terms, {"q": (7,), "qd": (7,)})
    for q, qd in states():
        compiled.inputs["q"][:], compiled.inputs["qd"][:] = q, qd
        compiled()
        for found, wanted in zip(compiled.outputs, terms(q, qd), strict=True):
            np.testing.assert_allclose(found, wanted, rtol=0, atol=100 * ROUNDING)


def test_the_coriolis_factor_gives_the_force_of_a_body_that_moves_freely() -> None:
    """B V = V x* (I V), the one thing that every such factor has to keep."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        half, V = rng.standard_normal((3, 3)), rng.standard_normal(6)
        inertia = spatial_inertia(2.0, rng.standard_normal(3), half @ half.T)
        force = -motion_cross(V).T @ (inertia @ V)
        np.testing.assert_allclose(coriolis_factor(inertia, V) @ V, force, rtol=0, atol=1e-11)


def test_a_turn_is_a_rotation_about_its_axis() -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    R = turned(axis, 0.7)
    np.testing.assert_allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-15)
    np.testing.assert_allclose(R @ axis, axis, rtol=0, atol=1e-15)
    assert np.trace(R) == pytest.approx(1 + 2 * np.cos(0.7), abs=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize(
    ("joint", "tcp", "problem"),
    [
        ('<joint name="j" type="slide" axis="1 0 0"/>', "b", "j: expected a chain of turning joints"),
        ('<joint name="j" axis="0 0 1"/>', "a", "the site 'tcp' is not on the last link"),
    ],
)
def test_an_arm_that_is_no_chain_of_turning_joints_is_refused(
    joint: str, tcp: str, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sites = {name: '<site name="tcp"/>' if name == tcp else "" for name in "ab"}
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    file = tmp_path / "arm.xml"
    file.write_text(
        f'<mujoco><worldbody><body name="a"><joint name="i" axis="0 0 1"/>{inertial}{sites["a"]}'
        f'<body name="b" pos="0 0 1">{joint}{inertial}{sites["b"]}</body></body></worldbody></mujoco>'
    )
    monkeypatch.setattr(arm_model, "arm_path", lambda name: file)
    with pytest.raises(AgentError, match=problem):
        ArmModel("panda")
