"""Before carrying: drive up to a strut, lower the hand over it, close the fingers. Ours; the paper's arms hold from the
start.

Knows what was told once (where the strut was, seen from the robot as it stood then) and what the robot itself feels:
its joints, how far its fingers are open, and how far its base has rolled. A strut that has moved meanwhile is missed.
"""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.errors import AgentError
from agents.motion import Motion, heading, level, planar, rotation
from agents.safety import CheckedEffort
from wire.messages import Vector

Array = NDArray[np.float64]

LIFT_M = 0.10
"""How high above the strut the hand comes in."""
OPEN_M, HELD_M = 0.08, 0.005
"""Fingers wide open; and an opening below which nothing is between them."""
STILL_S = 0.1
"""Fingers that have not moved for this time have closed on something, or on nothing."""
PATIENCE_S = 60.0
ARRIVED_M, ARRIVED_RAD, STOPPED_M_S = 0.003, 0.005, 0.005
"""Where the base may stand, and how slowly it must roll, before the hand is lowered."""


class ReachFailed(AgentError):
    """The hand did not get hold of its strut."""


class Phase(StrEnum):
    """What the robot is about."""

    APPROACH = "approach"
    LOWER = "lower"
    CLOSE = "close"
    HOLD = "hold"


class Reach:
    """One reach, tick by tick.

    Args:
        arm: the model.
        strut: where the hand shall grasp: position m and ``quat_wxyz``, (7,), in the arm's base frame at its welcome.
    """

    def __init__(self, arm: ArmModel, strut: Vector) -> None:
        self._arm, self._goal, self._R_goal = arm, np.array(strut[:3]), rotation(np.array(strut[3:]))
        self.phase = Phase.APPROACH
        self._motion: Motion | None = None
        self._place = np.zeros(3)
        """Where the hand is held while the base drives, in the arm's base frame."""
        self._aim = np.zeros(3)
        """Where the base shall stand: x, y, yaw of the odometry."""
        self._grip_m, self._still_s, self._elapsed_s = math.inf, 0.0, 0.0

    @property
    def holds(self) -> bool:
        """Whether the hand has closed on something: carry on."""
        return self.phase is Phase.HOLD

    def step(self, q: Array, qd: Array, grip_m: float, odometry: Vector, dt_s: float) -> tuple[CheckedEffort, float]:
        """Effort and wanted opening of the fingers, m, for one tick.

        Args:
            q, qd: joints, (n,) rad, rad/s.
            grip_m: how far the fingers are open.
            odometry: as in :class:`wire.messages.State`.
            dt_s: time since the tick before.

        Raises:
            ReachFailed: the fingers closed on nothing, or it takes too long.
        """
        self._elapsed_s += dt_s
        if self._elapsed_s > PATIENCE_S:
            raise ReachFailed(f"the hand has not got to its strut in {PATIENCE_S:g} s ({self.phase})")
        motion = self._motion or self._begin(q)
        if self.phase in (Phase.CLOSE, Phase.HOLD):  # a hand that holds is told no place any more: stay as it is
            self._close(grip_m, dt_s)
            return motion.effort(q, qd), 0.0
        base, rate = np.array(odometry[:3]), np.array(odometry[3:])
        turn = planar(-base[2])
        goal, R_goal = turn @ (self._goal - [base[0], base[1], 0.0]), turn @ self._R_goal
        off_m, turned = motion.drive(self._aim, base, dt_s)
        arrived = off_m < ARRIVED_M and turned < ARRIVED_RAD and float(np.abs(rate).max()) < STOPPED_M_S
        if self.phase is Phase.APPROACH:
            there = motion.move_hand(np.array([*self._place[:2], goal[2] + LIFT_M]), level(R_goal), dt_s)
            if arrived and there:
                self.phase = Phase.LOWER
        elif motion.move_hand(goal, R_goal, dt_s):
            self.phase = Phase.CLOSE
        return motion.effort(q, qd, rate), OPEN_M

    def _begin(self, q: Array) -> Motion:
        p, R, _ = self._arm.hand(q)
        self._motion, self._place = Motion(self._arm, q), p
        yaw = heading(self._R_goal @ R.T)
        self._aim = np.array([*(self._goal - planar(yaw) @ p)[:2], yaw])
        return self._motion

    def _close(self, grip_m: float, dt_s: float) -> None:
        self._still_s = self._still_s + dt_s if grip_m == self._grip_m else 0.0
        self._grip_m = grip_m
        if self._still_s < STILL_S:
            return
        if grip_m < HELD_M:
            raise ReachFailed("the fingers closed on nothing: the strut is not where it was; start the agent again")
        self.phase = Phase.HOLD
