"""States of the real arm for tests: the terms of task and null space at each, and MuJoCo's word on how it moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel, ArmSnapshot
from agents.equations.null_space import (
    null_basis_continued,
    null_basis_orthonormal,
    null_basis_partition,
    null_basis_rate,
    null_coriolis,
    null_inertia,
    null_inverse,
    null_inverse_rate,
    null_torque,
    null_velocity,
)
from agents.equations.task import dynamically_consistent_inverse, task_inertia
from wire.arms import arm_path

Array = NDArray[np.float64]

ALGEBRA = 1e-9
"""Relative: rounding of 2e-16, times the conditions of J M^-1 J^T (below 500 here) and of J_m (below 30), and some."""
H = 1e-5
"""Step of a central difference: cutting off costs H^2 = 1e-10 of the third derivative, rounding 2e-16 / H = 2e-11."""
DIFFERENCE = 1e-6
"""Relative, for differences with H of what holds J# or J_m^-1: the third derivative grows with 1 / sigma^3, and their
smallest singular values sigma go down to 0.1 and 0.05."""


def close(got: Array, expected: Array, relative: float) -> None:
    """Equal to ``relative`` of the largest number (at least 1) of what was expected."""
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(got, expected, rtol=0, atol=relative * scale)


def inverse(A: Array) -> Array:
    return cast(Array, np.linalg.inv(A))


# The real arm.


@dataclass(frozen=True)
class Terms:
    """The task's terms at one state."""

    arm: ArmSnapshot
    J: Array
    Jdot: Array
    Lambda_x: Array
    Jbar: Array


@cache
def model() -> ArmModel:
    return ArmModel("panda")


def terms(q: Array, qd: Array) -> Terms:
    arm = model().snapshot(q, qd)
    J = arm.J[2:5]
    Lambda_x = task_inertia(J, arm.M_inv)
    return Terms(arm, J, arm.Jdot[2:5], Lambda_x, dynamically_consistent_inverse(J, arm.M_inv, Lambda_x))


PIVOTS = ((1, 2, 5), (1, 3, 5), (1, 4, 5), (1, 5, 6))
"""Joints 2 to 7 by number from 0; the first joint is vertical and moves no task direction."""


def usable(J: Array) -> bool:
    """Away from postures in which the task, or a partition of it, is lost: there the numbers grow without bound."""
    task, *parts = (np.linalg.svd(part, compute_uv=False)[-1] for part in (J, *(J[:, list(p)] for p in PIVOTS)))
    return bool(task > 0.1 and min(parts) > 0.05)


def random_states(count: int) -> list[Terms]:
    """States within the joint limits, speeds up to the joints' limits (about 2 rad/s)."""
    mj = mujoco_model()
    rng = np.random.default_rng(30)
    found: list[Terms] = []
    while len(found) < count:
        state = terms(rng.uniform(*mj.jnt_range.T), rng.uniform(-2.0, 2.0, 7))
        if usable(state.J):
            found.append(state)
    return found


@cache
def mujoco_model() -> Any:
    return mujoco.MjModel.from_xml_path(str(arm_path("panda")))


def mujoco_acceleration(arm: ArmSnapshot, tau: Array) -> Array:
    """What the torque does to the arm, (n,) rad/s^2: MuJoCo's word, in which no equation of this project takes part."""
    data = mujoco.MjData(mujoco_model())
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = arm.q, arm.qd, tau
    mujoco.mj_forward(mujoco_model(), data)
    qdd: Array = data.qacc.copy()
    return qdd


STATES = random_states(20)
D = np.linspace(10.0, 30.0, 7)
K = np.linspace(800.0, 200.0, 7)
Q_ERR = np.array([0.01, -0.02, 0.015, 0.02, -0.01, 0.03, -0.025])


def partition_rate(J: Array, Jdot: Array, Z: Array, pivots: tuple[int, ...]) -> Array:
    """Rate of the partition basis: the identity in it stays, the rest follows from Jdot Z + J Zdot = 0."""
    Zdot = np.zeros_like(Z)
    Zdot[list(pivots)] = -np.linalg.solve(J[:, list(pivots)], Jdot @ Z)
    return Zdot


def orthonormal(state: Terms) -> Array:
    return null_basis_orthonormal(state.J)


def continued(state: Terms) -> Array:
    """Carried over from where the arm was 1 ms ago."""
    before = terms(state.arm.q - 1e-3 * state.arm.qd, state.arm.qd)
    return null_basis_continued(null_basis_orthonormal(before.J), state.J, state.Jbar)


def partition(*pivots: int) -> Callable[[Terms], Array]:
    return lambda state: null_basis_partition(state.J, pivots)


BASES: dict[str, Callable[[Terms], Array]] = {
    "orthonormal": orthonormal,
    "continued": continued,
    **{f"partition{p}": partition(*p) for p in PIVOTS},
}


@dataclass(frozen=True)
class Null:
    """The null space's terms for one basis that moves in one way."""

    Z: Array
    Lambda: Array
    Zbar: Array
    Zbar_dot: Array
    mu: Array
    nu: Array

    def torque(self, qd: Array, B_nu: Array, K: Array = K, q_err: Array = Q_ERR) -> Array:
        return null_torque(self.Zbar, self.Lambda, self.Zbar_dot, qd, self.mu, B_nu, self.nu, self.Z, K, q_err)


def null(state: Terms, Z: Array, Zdot: Array) -> Null:
    arm = state.arm
    Lambda = null_inertia(Z, arm.M)
    Lambda_inv = inverse(Lambda)
    Zbar = null_inverse(Z, arm.M, Lambda_inv)
    Zbar_dot = null_inverse_rate(Z, Zdot, Zbar, arm.M, arm.C + arm.C.T, Lambda_inv)
    return Null(Z, Lambda, Zbar, Zbar_dot, null_coriolis(Z, arm.C, Lambda, Zbar_dot), null_velocity(Zbar, arm.qd))


def at_rest(state: Terms, Z: Array) -> Null:
    """The basis moves by null_basis_rate."""
    return null(state, Z, null_basis_rate(state.Jbar, state.Jdot, Z))


def on_a_path(state: Terms, qdd: Array, s: float) -> Terms:
    """The state s seconds later on the path with constant joint acceleration."""
    arm = state.arm
    return terms(arm.q + s * arm.qd + 0.5 * s * s * qdd, arm.qd + s * qdd)
