"""Units, signs and power of the paper's equations on the real arm model."""

from __future__ import annotations

import numpy as np
import pytest
from arm_states import ALGEBRA, DIFFERENCE, STATES, D, H, K, at_rest, close, mujoco_acceleration, on_a_path
from numpy.typing import NDArray

from agents.equations.null_space import null_basis_orthonormal, null_damping
from agents.equations.stiffness import adaptive_stiffness, adaptive_stiffness_deg, projected_joint_error
from agents.equations.task import external_torque, task_acceleration, task_torque, task_velocity, tilt_error

Array = NDArray[np.float64]


# Stiffness and units.


def test_stiffness_in_si_is_the_papers_in_degrees() -> None:
    """Units converted by hand: 1 rad = 180/pi deg, so 1 N m/deg = 180/pi N m/rad."""
    rng = np.random.default_rng(36)
    deg = 180 / np.pi
    for _ in range(50):
        k_deg, q_err, rate = rng.uniform(1, 20, 7), 0.01 * rng.normal(size=7), 0.1 * rng.normal(size=7)
        by_platform = adaptive_stiffness_deg(k_deg, 100.0, q_err * deg, rate * deg)  # N m/deg
        in_si = adaptive_stiffness(k_deg * deg, 100.0, q_err, rate)  # N m/rad
        np.testing.assert_allclose(in_si, by_platform * deg, rtol=1e-13)  # a few roundings


def test_stiffness_at_rest_is_that_of_the_design_page() -> None:
    """K = k_nu + (867 p)^2 N m/rad on the unscaled projected error p = J# x_err, alpha 0.02, beta 100."""
    for state in STATES:
        x_err = np.array([0.01, 0.005, -0.008])
        p = state.Jbar @ x_err
        found = adaptive_stiffness(K, 100.0, projected_joint_error(0.02, state.Jbar, x_err), np.zeros(7)) - K
        # 867 is printed to three digits: 0.5 / 867, twice for the square; absolutely, rounding of K about 1000.
        np.testing.assert_allclose(found, (867 * p) ** 2, rtol=1.2e-3, atol=1e-12)


def test_motion_softens_and_stiffness_never_falls_below_its_least() -> None:
    q_err = np.array([0.01, 0.01, 0.01, 0.0])
    rate = np.array([0.0, 0.01, -0.01, -0.01])
    K = adaptive_stiffness(np.full(4, 286.0), 100.0, q_err, rate)
    assert K[0] > K[1] > 286.0
    assert (K[1], K[3]) == (K[2], 286.0)


# Signs and power.


def turned(r: Array) -> Array:
    """Rotation matrix of the rotation vector r (Rodrigues)."""
    angle = float(np.linalg.norm(r))
    x, y, z = r / angle
    S = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R: Array = np.eye(3) + np.sin(angle) * S + (1 - np.cos(angle)) * S @ S
    return R


E_Z = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("roll_pitch", [(1e-3, 0.0), (0.0, 1e-3), (-4e-4, 7e-4), (6e-4, 6e-4)])
def test_tilt_error_is_the_rotation_back_upright_for_small_roll_and_pitch(roll_pitch: tuple[float, float]) -> None:
    r = np.array([*roll_pitch, 0.0])
    # The sine of the angle: off by its third power over 6, 1.7e-10 for 1e-3.
    np.testing.assert_allclose(tilt_error(turned(r) @ E_Z), -r[:2], rtol=0, atol=2e-10)


def test_tilt_error_is_blind_to_yaw() -> None:
    tilted = turned(np.array([0.1, -0.2, 0.0]))
    for yaw in (0.3, -2.0, 3.1):
        turn = turned(yaw * E_Z)
        assert np.array_equal(tilt_error(turn @ E_Z), [0.0, 0.0])  # an upright hand that turned
        assert np.array_equal(tilt_error(tilted @ (turn @ E_Z)), tilt_error(tilted @ E_Z))  # a tilted one, round itself
        np.testing.assert_allclose(  # a tilted one, round the vertical: as tilted as before, in another direction
            np.linalg.norm(tilt_error(turn @ tilted @ E_Z)), np.linalg.norm(tilt_error(tilted @ E_Z)), rtol=1e-14
        )


def test_task_velocity_reduces_the_tilt_error_that_it_has() -> None:
    """The error's rate is minus the rows w_x, w_y of J qd when the hand is upright: the rows belong to the error."""
    for state in STATES:
        u_E = state.arm.R_BE.T @ E_Z
        after, before = (on_a_path(state, np.zeros(7), s).arm.R_BE @ u_E for s in (H, -H))
        rate = (tilt_error(after) - tilt_error(before)) / (2 * H)
        close(rate, -task_velocity(state.J, state.arm.qd)[1:], DIFFERENCE)


def test_a_hand_that_is_too_low_is_pushed_upwards() -> None:
    for state in STATES:
        x_err = np.array([0.01, 0.0, 0.0])  # x_d - x: wanted 10 mm above where it is
        xdd_c = task_acceleration(np.zeros(3), np.zeros(3), x_err, np.full(3, 1.0), np.full(3, 80.0))
        tau = task_torque(state.J, state.Lambda_x, xdd_c, state.Jbar, np.zeros(7))
        qdd = mujoco_acceleration(state.arm, tau + state.arm.C @ state.arm.qd + state.arm.g)
        close(state.J @ qdd, np.array([0.8, 0.0, 0.0]), ALGEBRA)  # 80 1/s^2 times 10 mm, and no tilting
        # The observer is a spring: an upward force too. (Not decoupled: it tilts as well, and by way of that the
        # acceleration can even be downwards in postures far from the working one.)
        assert (state.Jbar.T @ external_torque(K, state.Jbar, x_err))[0] > 0


def test_task_damping_takes_twice_the_tasks_kinetic_energy_per_time_constant() -> None:
    """qd^T J^T Lambda_x (-B_e xd) with B_e = b I is -2 b times the least kinetic energy of that task motion."""
    b = 1.0
    for state in STATES:
        qd = state.arm.qd
        xdd_c = task_acceleration(
            np.zeros(3), -task_velocity(state.J, qd), np.zeros(3), np.full(3, b), np.full(3, 80.0)
        )
        power = qd @ task_torque(state.J, state.Lambda_x, xdd_c, state.Jbar, np.zeros(7))
        slowest = state.Jbar @ (state.J @ qd)
        energy = 0.5 * slowest @ state.arm.M @ slowest
        assert power < 0
        assert power == pytest.approx(-2 * b * energy, rel=ALGEBRA)


def test_null_damping_takes_what_joint_dampers_take_from_the_null_motion() -> None:
    """The damping's part of eq. 13 has the power -nu^T B_nu nu: that of dampers D on the joints at the speeds Z nu."""
    for state in STATES:
        part = at_rest(state, null_basis_orthonormal(state.J))
        qd, B_nu = state.arm.qd, null_damping(part.Z, D)
        torque = part.torque(qd, B_nu) - part.torque(qd, np.zeros((4, 4)))
        null_motion = qd - state.Jbar @ (state.J @ qd)
        assert qd @ torque < 0
        assert qd @ torque == pytest.approx(-(D * null_motion) @ null_motion, rel=ALGEBRA)
