"""The motor driver of one arm and its base: the rules of a real arm's torque interface, and of nothing else.

Torque and torque-rate limits, the last command held over a missed tick, and what a lost arm does. No physics here.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIMP_DAMPING_NMS_RAD = 5.0
"""Joint damping of a lost arm that goes limp."""


class MotorDriver:
    """Turns commands into applied torques, step by step.

    Args:
        torque_max: (n,) N m.
        torque_rate_max: N m/s, for every joint.
        base_max: (3,) N, N, N m: bounds of the base's drive.
        start_torque: (n,) N m, applied before the first command (the arm holds its share when the run begins).
        delay_ticks: ticks between a command and its effect.
    """

    def __init__(
        self,
        torque_max: Array,
        torque_rate_max: float,
        base_max: Array,
        start_torque: Array,
        delay_ticks: int = 0,
    ) -> None:
        self._torque_max, self._rate_max, self._base_max = torque_max, torque_rate_max, base_max
        self.torque = start_torque.copy()
        """Torque applied now, (n,) N m."""
        self.base_force = np.zeros(3)
        """Base force applied now, (3,), in the base frame B."""
        self._target = start_torque.copy()
        self._base_target = np.zeros(3)
        self._delay = delay_ticks
        self._on_the_way: deque[tuple[Array, Array] | None] = deque([None] * delay_ticks)
        self.limp = False

    def tick(self, command: tuple[Array, Array] | None) -> None:
        """Take this tick's command (joint torque (n,), base force (3,) in B), or None for a missed tick: the last one
        is held."""
        if self._delay:
            self._on_the_way.append(command)
            command = self._on_the_way.popleft()
        if command is not None:
            self._target, self._base_target = command

    def lose(self) -> None:
        """The arm is lost: from now on it is limp and what is still on the way is dropped."""
        self.limp = True
        self._on_the_way = deque([None] * self._delay)

    def regain(self) -> None:
        """An agent has the arm again: it obeys commands, starting from the torque applied now."""
        self.limp = False
        self._target, self._base_target = self.torque.copy(), np.zeros(3)

    def advance(self, dt_s: float, gravity: Array, qd: Array) -> None:
        """Move the applied torque towards the target within the limits.

        Args:
            dt_s: one physics step.
            gravity: torque that holds the arm itself up, (n,) N m: the driver's own, used when limp.
            qd: joint velocities, (n,) rad/s.
        """
        target = gravity - LIMP_DAMPING_NMS_RAD * qd if self.limp else self._target
        base = np.zeros(3) if self.limp else self._base_target
        step = self._rate_max * dt_s
        limited = np.minimum(np.maximum(target, -self._torque_max), self._torque_max)
        self.torque = self.torque + np.minimum(np.maximum(limited - self.torque, -step), step)
        self.base_force = np.minimum(np.maximum(base, -self._base_max), self._base_max)
