"""The motor drivers of all arms and bases: the rules of a real arm's torque interface, and of nothing else.

Torque and torque-rate limits, the last command held over a missed tick, and what a lost arm does. No physics here. One
row per arm, so that many arms cost little more than one.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIMP_DAMPING_NMS_RAD = 5.0
"""Joint damping of a lost arm that goes limp."""


class MotorDrivers:
    """Turns commands into applied torques, step by step, for N arms with n joints.

    Args:
        start_torque: (N, n) N m, applied before the first command (the arms hold their share when the run begins).
        torque_max: (n,) N m.
        torque_rate_max: N m/s, for every joint.
        base_max: (3,) N, N, N m: bounds of a base's drive.
        delay_ticks: ticks between a command and its effect.
    """

    def __init__(
        self, start_torque: Array, torque_max: Array, torque_rate_max: float, base_max: Array, delay_ticks: int = 0
    ) -> None:
        arms = len(start_torque)
        self._torque_max, self._rate_max, self._base_max = torque_max, torque_rate_max, base_max
        self.torque = start_torque.copy()
        """Torques applied now, (N, n) N m."""
        self.base_force = np.zeros((arms, 3))
        """Base forces applied now, (N, 3), each in its base frame B."""
        self.age_ticks = np.zeros(arms, dtype=int)
        """Ticks since each arm's last command came, (N,)."""
        self._given = np.zeros(arms, dtype=bool)
        self._command, self._base_command = start_torque.copy(), np.zeros((arms, 3))
        self._target, self._base_target = start_torque.copy(), np.zeros((arms, 3))
        self._on_the_way = deque((start_torque.copy(), np.zeros((arms, 3))) for _ in range(delay_ticks))
        self._limp = np.zeros((arms, 1), dtype=bool)

    def command(self, arm: int, torque: Array, base_force: Array) -> None:
        """This tick's command of one arm: joint torque (n,) N m, base force (3,) in B."""
        self._command[arm] = torque
        self._base_command[arm] = base_force
        self._given[arm] = True

    def tick(self) -> None:
        """Close a tick: what was commanded becomes the target, after the delay; an arm without a command keeps its
        last one."""
        self.age_ticks = np.where(self._given, 0, self.age_ticks + 1)
        self._given[:] = False
        self._on_the_way.append((self._command.copy(), self._base_command.copy()))
        self._target, self._base_target = self._on_the_way.popleft()

    def lose(self, arm: int) -> None:
        """The arm is lost: it is limp until somebody regains it."""
        self._limp[arm] = True

    def regain(self, arm: int) -> None:
        """Somebody drives the arm again: it obeys commands, starting from the torque applied now."""
        self._limp[arm] = False
        for torque, base in [(self._command, self._base_command), *self._on_the_way]:
            torque[arm], base[arm] = self.torque[arm], 0.0

    def advance(self, dt_s: float, gravity: Array, qd: Array) -> None:
        """Move the applied torques towards their targets within the limits.

        Args:
            dt_s: one physics step.
            gravity: torques that hold the arms themselves up, (N, n) N m: the drivers' own knowledge, for limp arms.
            qd: joint velocities, (N, n) rad/s.
        """
        target = np.where(self._limp, gravity - LIMP_DAMPING_NMS_RAD * qd, self._target)
        limited = np.minimum(np.maximum(target, -self._torque_max), self._torque_max)
        step = self._rate_max * dt_s
        self.torque = self.torque + np.minimum(np.maximum(limited - self.torque, -step), step)
        base = np.where(self._limp, 0.0, self._base_target)
        self.base_force = np.minimum(np.maximum(base, -self._base_max), self._base_max)
