"""The motor drivers keep the rules of a real arm's torque interface."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_server.motor_drivers import MotorDrivers
from sim_server.unled_arms import LIMP_DAMPING_NMS_RAD, Felt, Limp
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]

DT_S = 0.001
PANDA = arm_limits("panda")
TORQUE_MAX = np.array(PANDA.torque_Nm)
BASE_MAX = np.array([300.0, 300.0, 60.0])
START = np.tile([0.0, -20.0, 0.0, 22.0, 0.0, 2.0, 0.0], (2, 1))
NOTHING = np.zeros((2, 7))


def drivers(delay_ticks: int = 0) -> MotorDrivers:
    """Two arms with the Panda's limits that hold something at the start."""
    return MotorDrivers(START, TORQUE_MAX, PANDA.torque_rate_Nm_s, BASE_MAX, delay_ticks)


def command(motors: MotorDrivers, arm: int, torque: Array, base: tuple[float, float, float] = (0, 0, 0)) -> None:
    motors.command(arm, torque, np.array(base))


def felt(gravity: Array = NOTHING, qd: Array = NOTHING, q: Array = NOTHING) -> Felt:
    still = np.zeros((len(q), 3))
    return Felt(gravity, q, qd, still, still)


def advance(motors: MotorDrivers, steps: int = 1, gravity: Array = NOTHING, qd: Array = NOTHING) -> None:
    for _ in range(steps):
        motors.advance(DT_S, felt(gravity, qd))


def test_the_pandas_limits_are_the_published_ones() -> None:
    """Franka Control Interface documentation, "Robot limits": every test below builds on these."""
    assert PANDA.torque_Nm == (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
    assert PANDA.torque_rate_Nm_s == 1000.0


def test_before_the_first_command_the_start_torque_is_held() -> None:
    motors = drivers()
    for _ in range(5):
        motors.tick()
        advance(motors)
    np.testing.assert_array_equal(motors.torque, START)
    np.testing.assert_array_equal(motors.base_force, 0)
    np.testing.assert_array_equal(motors.age_ticks, 5)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_torque_leaves_its_joints_limit_whatever_is_commanded(sign: float) -> None:
    motors = drivers()
    command(motors, 0, sign * np.full(7, 1e4), (sign * 1e5, -sign * 1e5, sign * 1e5))
    motors.tick()
    advance(motors, steps=200)  # 87 N m from -22 take 109 steps of 1 N m
    np.testing.assert_array_equal(motors.torque[0], sign * TORQUE_MAX)
    np.testing.assert_array_equal(motors.base_force[0], sign * BASE_MAX * [1, -1, 1])
    np.testing.assert_array_equal(motors.torque[1], START[1])  # the other arm has its own


def test_torque_moves_by_1000_newton_metres_a_second_and_then_stays() -> None:
    motors = drivers()
    target = START[0] + [5.0, -5.0, 0.25, 0.0, 2.5, -2.5, 0.0]
    command(motors, 0, target)
    motors.tick()
    for step in range(1, 8):
        advance(motors)
        # 1 N m in 1 ms, towards the target, never past it. Tolerance: seven additions of numbers below 32.
        moved = np.clip(target - START[0], -step, step)
        np.testing.assert_allclose(motors.torque[0], START[0] + moved, rtol=0, atol=1e-13)


@pytest.mark.parametrize("dt_s", [0.0005, 0.002])
def test_the_rate_limit_is_per_second_not_per_step(dt_s: float) -> None:
    motors = drivers()
    command(motors, 0, START[0] + 50.0)
    motors.tick()
    for _ in range(round(0.010 / dt_s)):
        motors.advance(dt_s, felt())
    # 10 ms: 10 N m. Tolerance: twenty additions of numbers below 64.
    np.testing.assert_allclose(motors.torque[0, :4], START[0, :4] + 10.0, rtol=0, atol=1e-12)


def test_a_missed_tick_holds_the_last_command_and_ages_it() -> None:
    motors = drivers()
    wanted = START[0] + 0.5
    command(motors, 0, wanted, (10.0, -5.0, 2.0))
    motors.tick()
    advance(motors)
    for missed in range(1, 4):
        command(motors, 1, START[1] - 0.5)
        motors.tick()
        advance(motors)
        np.testing.assert_array_equal(motors.torque[0], wanted)
        np.testing.assert_array_equal(motors.base_force[0], [10.0, -5.0, 2.0])
        np.testing.assert_array_equal(motors.age_ticks, [missed, 0])
    command(motors, 0, START[0])
    motors.tick()
    np.testing.assert_array_equal(motors.age_ticks, [0, 1])


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_command_acts_exactly_so_many_ticks_later(delay: int) -> None:
    motors = drivers(delay)
    seen = []
    for tick in range(8):
        command(motors, 0, START[0] + 0.1 * (tick + 1), (float(tick + 1), 0.0, 0.0))
        motors.tick()
        advance(motors)
        seen.append((motors.torque[0, 0], motors.base_force[0, 0]))
    acted = [max(0, tick + 1 - delay) for tick in range(8)]
    # The first joint starts at 0; 0.1 N m a tick is below the rate limit, so a target is reached within its tick.
    np.testing.assert_allclose(seen, [(0.1 * k, float(k)) for k in acted], rtol=0, atol=1e-15)


def test_a_lost_arm_goes_limp_at_the_rate_limit_and_lets_its_base_roll() -> None:
    motors = drivers()
    gravity, qd = NOTHING + 4.0, np.zeros((2, 7))
    qd[:, 1], qd[:, 3] = 0.2, -0.4
    command(motors, 0, START[0], (50.0, 0.0, 0.0))
    motors.tick()
    advance(motors)
    motors.leave_to(0, Limp())
    before = motors.torque.copy()
    advance(motors, gravity=gravity, qd=qd)
    assert np.abs(motors.torque - before).max() <= 1.0 + 1e-12  # 1000 N m/s for 1 ms, and rounding
    np.testing.assert_array_equal(motors.base_force[0], 0)
    advance(motors, steps=50, gravity=gravity, qd=qd)
    # Held up by gravity's own torque, and braked: the torque beyond gravity takes energy out of every joint that moves.
    beyond = motors.torque[0] - gravity[0]
    np.testing.assert_allclose(beyond, -LIMP_DAMPING_NMS_RAD * qd[0], rtol=0, atol=1e-12)
    assert (beyond * qd[0]).sum() < 0
    np.testing.assert_array_equal(motors.torque[1], START[1])


def test_a_lost_arm_obeys_nobody() -> None:
    motors = drivers()
    motors.leave_to(0, Limp())
    command(motors, 0, START[0] + 30.0, (100.0, 0.0, 0.0))
    motors.tick()
    advance(motors, steps=100, gravity=START)
    np.testing.assert_array_equal(motors.torque[0], START[0])
    np.testing.assert_array_equal(motors.base_force[0], 0)


@pytest.mark.parametrize("delay", [0, 2])
def test_a_regained_arm_starts_from_the_torque_that_is_applied(delay: int) -> None:
    """No bump: neither the command from before the loss nor one still on the way comes back."""
    motors = drivers(delay)
    for _ in range(3):
        command(motors, 0, START[0] + 10.0, (80.0, 0.0, 0.0))
        motors.tick()
        advance(motors, steps=20)
    motors.leave_to(0, Limp())
    advance(motors, steps=100, gravity=NOTHING + 3.0)
    limp = motors.torque[0].copy()
    motors.regain(0)
    for _ in range(4):  # the first command of the new instance is still on its way
        motors.tick()
        advance(motors)
        np.testing.assert_array_equal(motors.torque[0], limp)
        np.testing.assert_array_equal(motors.base_force[0], 0)
    command(motors, 0, limp + 0.5)
    for _ in range(delay + 1):
        motors.tick()
        advance(motors)
    np.testing.assert_allclose(motors.torque[0], limp + 0.5, rtol=0, atol=1e-15)
