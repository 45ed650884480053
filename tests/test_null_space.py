"""Null space and task as laws of mechanics on the real arm model: neither disturbs the other, whatever the basis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from arm_states import (
    ALGEBRA,
    BASES,
    DIFFERENCE,
    PIVOTS,
    Q_ERR,
    STATES,
    D,
    H,
    K,
    Null,
    Terms,
    at_rest,
    close,
    continued,
    inverse,
    mujoco_acceleration,
    null,
    on_a_path,
    partition_rate,
    terms,
)
from numpy.typing import NDArray

from agents.equations.law import joint_torque
from agents.equations.null_space import (
    null_acceleration,
    null_basis_continued,
    null_basis_orthonormal,
    null_basis_partition,
    null_basis_rate,
    null_damping,
    null_inertia,
    null_inverse,
    null_projection,
    null_torque_projected,
    null_velocity,
)
from agents.equations.task import task_drift, task_inertia, task_torque

Array = NDArray[np.float64]


@pytest.mark.parametrize("name", BASES)
def test_no_motion_of_the_null_space_moves_the_task_and_the_inverses_belong_together(name: str) -> None:
    for state in STATES:
        Z = BASES[name](state)
        Zbar = null_inverse(Z, state.arm.M, inverse(null_inertia(Z, state.arm.M)))
        assert np.linalg.matrix_rank(Z) == 4
        close(state.J @ Z, np.zeros((3, 4)), ALGEBRA)
        close(state.J @ state.Jbar, np.eye(3), ALGEBRA)
        close(Zbar @ state.Jbar, np.zeros((4, 3)), ALGEBRA)
        close(Zbar @ Z, np.eye(4), ALGEBRA)
        # Eq. 12 is a change of coordinates: nothing of the motion is lost.
        close(state.Jbar @ state.J + Z @ Zbar, np.eye(7), ALGEBRA)


def test_the_papers_first_columns_are_singular_in_every_posture_of_this_arm() -> None:
    """The first joint is vertical: it neither lifts nor tilts the hand."""
    for state in STATES:
        assert np.abs(state.J[:, 0]).max() < 1e-15  # rounding of a product of rotations
        assert np.linalg.svd(state.J[:, :3], compute_uv=False)[-1] < 1e-15
    with pytest.raises(np.linalg.LinAlgError):
        null_basis_partition(np.array([[0.0, 1.0]]), [0])


def test_a_task_that_is_lost_is_an_error() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        task_inertia(np.array([[1.0, 0.0], [0.0, 0.0]]), np.eye(2))


def test_dynamically_consistent_inverse_takes_the_motion_of_least_kinetic_energy() -> None:
    """Minimise v^T M v / 2 under J v = b by its own optimality conditions: M v = J^T f, J v = b. The multiplier f is
    the impulse that makes the motion: Lambda_x b."""
    for state in STATES:
        system = np.block([[state.arm.M, -state.J.T], [state.J, np.zeros((3, 3))]])
        solution = np.linalg.solve(system, np.vstack([np.zeros((7, 3)), np.eye(3)]))
        close(state.Jbar, solution[:7], ALGEBRA)
        close(state.Lambda_x, solution[7:], ALGEBRA)


@pytest.mark.parametrize("name", BASES)
def test_task_and_null_space_do_not_accelerate_each_other(name: str) -> None:
    rng = np.random.default_rng(31)
    for state in STATES:
        part = at_rest(state, BASES[name](state))
        F, f = 100 * rng.normal(size=3), 100 * rng.normal(size=4)
        close(part.Zbar @ state.arm.M_inv @ state.J.T @ F, np.zeros(4), 100 * ALGEBRA)  # forces of 100
        close(state.J @ state.arm.M_inv @ part.Zbar.T @ f, np.zeros(3), 100 * ALGEBRA)


def law(state: Terms, part: Null, xdd_c: Array, tau_e: Array, K: Array = K, D: Array = D) -> Array:
    """The whole law, eq. 5, with the drift compensated."""
    arm = state.arm
    tau_task = task_torque(state.J, state.Lambda_x, xdd_c - task_drift(state.Jdot, arm.qd), state.Jbar, tau_e)
    return joint_torque(tau_task, part.torque(arm.qd, null_damping(part.Z, D), K), arm.C, arm.qd, arm.g)


def test_the_moving_arm_obeys_the_task_command_and_the_null_space_does_not_notice() -> None:
    """With accelerations from MuJoCo: xdd = xdd_c + Lambda_x^-1 J#^T tau_e whatever the null space does, and nud is
    the same whatever the task does."""
    rng = np.random.default_rng(32)
    for state in STATES:
        arm, part = state.arm, at_rest(state, null_basis_orthonormal(state.J))
        xdd_c, other_xdd_c = rng.normal(size=3), rng.normal(size=3)
        tau_e, other_tau_e = rng.normal(size=7), rng.normal(size=7)
        qdd = mujoco_acceleration(arm, law(state, part, xdd_c, tau_e))
        other_task = mujoco_acceleration(arm, law(state, part, other_xdd_c, other_tau_e))
        other_null = mujoco_acceleration(arm, law(state, part, xdd_c, tau_e, 3 * K, 0.1 * D))

        wanted = xdd_c + state.J @ arm.M_inv @ state.J.T @ state.Jbar.T @ tau_e
        close(state.J @ qdd + state.Jdot @ arm.qd, wanted, ALGEBRA)
        close(state.J @ other_null + state.Jdot @ arm.qd, wanted, ALGEBRA)
        assert np.abs(part.Zbar @ (other_null - qdd)).max() > 0.1  # the null space did change
        close(part.Zbar @ other_task, part.Zbar @ qdd, ALGEBRA)
        assert np.abs(state.J @ (other_task - qdd)).max() > 0.1  # the task did change


Mover = Callable[[Terms, Terms, Array], Array]


def projected(now: Terms, then: Terms, Z: Array) -> Array:
    """The basis of now carried over to then, with nothing done to its columns: what null_basis_rate is the rate of."""
    return Z - then.Jbar @ (then.J @ Z)


def kept_orthonormal(now: Terms, then: Terms, Z: Array) -> Array:
    return null_basis_continued(Z, then.J, then.Jbar)


def partitioned(now: Terms, then: Terms, Z: Array) -> Array:
    return null_basis_partition(then.J, PIVOTS[0])


PATHS: dict[str, Mover] = {"projected": projected, "continued": kept_orthonormal, "partition": partitioned}


def start(path: str, state: Terms) -> Array:
    return null_basis_partition(state.J, PIVOTS[0]) if path == "partition" else null_basis_orthonormal(state.J)


@dataclass(frozen=True)
class Rates:
    """Central differences along a path: what the analytic rates must be."""

    Z: Array
    Zbar: Array
    Lambda: Array
    nu: Array


def rates(path: str, state: Terms, Z: Array, qdd: Array) -> Rates:
    sides = []
    for s in (H, -H):
        then = on_a_path(state, qdd, s)
        Z_then = PATHS[path](state, then, Z)
        Lambda = null_inertia(Z_then, then.arm.M)
        Zbar = null_inverse(Z_then, then.arm.M, inverse(Lambda))
        sides.append((Z_then, Zbar, Lambda, null_velocity(Zbar, then.arm.qd)))
    return Rates(*((after - before) / (2 * H) for after, before in zip(*sides, strict=True)))


def test_basis_rate_is_that_of_the_projected_basis_and_rests_in_the_metric_of_m() -> None:
    for state in STATES:
        Z = null_basis_orthonormal(state.J)
        Zdot = null_basis_rate(state.Jbar, state.Jdot, Z)
        close(Zdot, rates("projected", state, Z, np.zeros(7)).Z, DIFFERENCE)
        close(Z.T @ state.arm.M @ Zdot, np.zeros((4, 4)), ALGEBRA)


@pytest.mark.parametrize("path", PATHS)
def test_basis_rate_is_that_of_any_moving_basis_but_for_a_mixing_of_its_columns(path: str) -> None:
    """Z(t+h) = Z(t) + h (Zdot + Z W): the columns may be mixed by any W, which eq. 13 does not see."""
    for state in STATES:
        Z = start(path, state)
        found = rates(path, state, Z, np.zeros(7)).Z
        Zbar = null_inverse(Z, state.arm.M, inverse(null_inertia(Z, state.arm.M)))
        close(found - Z @ (Zbar @ found), null_basis_rate(state.Jbar, state.Jdot, Z), DIFFERENCE)


@pytest.mark.parametrize("path", PATHS)
def test_rate_of_the_null_inverse_is_its_derivative_along_the_motion(path: str) -> None:
    for state in STATES:
        Z = start(path, state)
        found = rates(path, state, Z, np.zeros(7))
        Zdot = null_basis_rate(state.Jbar, state.Jdot, Z) if path == "projected" else found.Z
        close(null(state, Z, Zdot).Zbar_dot, found.Zbar, DIFFERENCE)


@pytest.mark.parametrize("path", PATHS)
def test_null_coriolis_keeps_energy(path: str) -> None:
    """Lambda_nu_dot - 2 mu_nu is skew: the Coriolis force of the null space does no work."""
    for state in STATES:
        Z = start(path, state)
        found = rates(path, state, Z, np.zeros(7))
        mu = null(state, Z, found.Z).mu
        close(mu + mu.T, found.Lambda, DIFFERENCE)


@pytest.mark.parametrize("path", PATHS)
def test_eq_13_with_eq_5_gives_eq_11_on_the_moving_arm(path: str) -> None:
    """nu = Z# qd differentiated along the motion that MuJoCo makes of the torque: Lambda_nu nud + (mu_nu + B_nu) nu =
    Z^T K q_err. So C qd of eq. 5 and mu_nu of eq. 13 are both needed, and no force is counted twice."""
    rng = np.random.default_rng(33)
    for state in STATES:
        Z = start(path, state)
        Zdot = rates(path, state, Z, np.zeros(7)).Z
        part = null(state, Z, Zdot)
        B_nu = null_damping(Z, D)
        qdd = mujoco_acceleration(state.arm, law(state, part, rng.normal(size=3), rng.normal(size=7)))
        nud = rates(path, state, Z, qdd).nu
        close(part.Lambda @ nud, -(part.mu + B_nu) @ part.nu + Z.T @ (K * Q_ERR), DIFFERENCE)
        close(null_acceleration(inverse(part.Lambda), part.mu, B_nu, part.nu, Z, K, Q_ERR), nud, DIFFERENCE)


def mixed(state: Terms, seed: int) -> Null:
    """An orthonormal basis with its columns mixed by a random A(t): Z A, of rate Zdot A + Z Adot."""
    rng = np.random.default_rng(seed)
    A, Adot = 2.0 * np.eye(4) + 0.3 * rng.normal(size=(4, 4)), rng.normal(size=(4, 4))
    Z = null_basis_orthonormal(state.J)
    return null(state, Z @ A, null_basis_rate(state.Jbar, state.Jdot, Z) @ A + Z @ Adot)


def bases_and_rates(state: Terms) -> dict[str, Null]:
    """One state, many bases, each moving in its own way."""
    found = {"continued": at_rest(state, continued(state)), "mixed": mixed(state, 34), "mixed anew": mixed(state, 35)}
    for pivots in PIVOTS:
        Z = null_basis_partition(state.J, pivots)
        found[f"partition {pivots}"] = null(state, Z, partition_rate(state.J, state.Jdot, Z, pivots))
        found[f"partition {pivots} at rest"] = at_rest(state, Z)
    return found


def test_null_torque_does_not_depend_on_the_basis_nor_on_how_it_moves() -> None:
    for state in STATES:
        expected = at_rest(state, null_basis_orthonormal(state.J))
        torque = expected.torque(state.arm.qd, null_damping(expected.Z, D))
        for other in bases_and_rates(state).values():
            close(other.torque(state.arm.qd, null_damping(other.Z, D)), torque, ALGEBRA)


def test_null_torque_without_a_basis_is_eq_13() -> None:
    """What runs is the printed equation, for every basis, to rounding."""
    for state in STATES:
        arm = state.arm
        bases = {"orthonormal": at_rest(state, null_basis_orthonormal(state.J)), **bases_and_rates(state)}
        for part in bases.values():
            printed = part.torque(arm.qd, null_damping(part.Z, D))
            args = (state.J, state.Jdot, state.Jbar, state.Lambda_x, arm.C, D, arm.qd, K, Q_ERR)
            close(null_torque_projected(*args), printed, ALGEBRA)


def test_null_torque_would_depend_on_the_basis_with_the_printed_damping() -> None:
    """B_nu = 0.4 I (22.9 I in SI) in the coordinates of nu means another force for every basis."""
    B_nu = 22.9 * np.eye(4)
    for state in STATES:
        torque = at_rest(state, null_basis_orthonormal(state.J)).torque(state.arm.qd, B_nu)
        for name, other in bases_and_rates(state).items():
            # Only orthonormal bases agree: one is the other turned, and I turns into itself. (What the continued one
            # lacks of orthonormality shows here: 3e-4 N m; of the others none differs by less than 1 N m.)
            differs = np.abs(other.torque(state.arm.qd, B_nu) - torque).max()
            assert differs < 1e-3 if name == "continued" else differs > 0.5, (name, differs)


def test_continued_basis_stays_orthonormal_and_continuous_over_a_long_motion() -> None:
    """Half a second at the joints' speed limits, 1 ms steps. The projection shortens and shears the columns by up to
    e = 1.8e-3 a step here; one Newton-Schulz step leaves 3/4 e^2 = 2.4e-6 of that, and it must not add up."""
    state = terms(np.array([0.0, -0.1, 0.0, -2.1, 0.0, 2.0, 0.8]), np.zeros(7))
    Z = null_basis_orthonormal(state.J)
    for k in range(1, 501):
        phase = 2 * np.pi * 1e-3 * k + np.arange(7)
        then = terms(state.arm.q + 0.3 * (np.sin(phase) - np.sin(np.arange(7))), np.zeros(7))
        before, Z = Z, null_basis_continued(Z, then.J, then.Jbar)
        assert np.abs(then.J @ Z).max() < 1e-12  # rounding: J J# = I
        assert np.abs(Z.T @ Z - np.eye(4)).max() < 2.4e-6
        assert np.abs(Z - before).max() < 4e-3  # they turn by up to |J#| |Jdot| 1 ms: 2.9e-3 measured


def test_a_torque_that_is_projected_does_not_accelerate_the_task() -> None:
    rng = np.random.default_rng(32)
    for state in STATES:
        tau = null_projection(state.J, state.Jbar, 50.0 * rng.standard_normal(7))
        close(state.J @ state.arm.M_inv @ tau, np.zeros(3), 100 * ALGEBRA)  # accelerations of 1e3
