"""After carrying: let the share down, open the hand, lift it off the strut, drive clear. Ours; the paper's never leave.

Knows nothing but what the robot itself feels. What the others feel of it is that a share of the load becomes theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.motion import Motion, planar
from agents.reach import LIFT_M, OPEN_M
from agents.safety import CheckedEffort, remaining_offset
from wire.messages import Vector

Array = NDArray[np.float64]

LIMP_NMS_RAD = 5.0
"""Joint damping of the arm as it has let its share down."""
TOUCH_M, LOOSE_M = 1e-6, 0.01
"""How far the fingers open before they hold no more, and before the hand is lifted."""
BACK_M, DRAWN_M = 1.2, 0.10
"""How far the base drives backward, and how far the hand is drawn back meanwhile."""
CLEAR_M, SLOW_M_S = 0.02, 0.05
"""Nearer to its aim, and slower, it stands clear."""
PATIENCE_S = 20.0
"""For all that comes after the share has been let down; it takes 5 to 6 s."""


class Phase(StrEnum):
    """What the robot is about."""

    LET_DOWN = "let down"
    OPEN = "open"
    LIFT = "lift"
    DRIVE = "drive"
    CLEAR = "clear"


class Retreat:
    """One retreat, tick by tick.

    Args:
        arm: the model.
        let_down_s: time over which the share is let down.
        holds: whether the hand holds now; an empty one lets nothing down.
    """

    def __init__(self, arm: ArmModel, let_down_s: float, *, holds: bool) -> None:
        self._arm, self._let_down_s = arm, let_down_s
        self.phase = Phase.LET_DOWN if holds else Phase.OPEN
        self._elapsed_s = 0.0
        self._motion: Motion | None = None
        self._base_force: tuple[float, ...] = (0.0,) * 3
        """What the law wanted of the base last: it follows the load until the hand lets go."""
        self._closed_m, self._is_loose = 0.0, False
        """How far the fingers were open as they began to open; and whether they have opened since."""
        self._up, self._R_hand = np.zeros(3), np.eye(3)
        """Where the hand is lifted to, above where it let go, in the arm's base frame."""
        self._aim = np.zeros(3)
        """Where the base shall stand: x, y, yaw of the odometry."""

    @property
    def is_over(self) -> bool:
        """Whether the robot stands clear: say goodbye. Also if that has taken too long: the arm's driver sees to the
        rest."""
        return self.phase is Phase.CLEAR or self._elapsed_s > self._let_down_s + PATIENCE_S

    def step(
        self,
        law: Callable[[], CheckedEffort],
        q: Array,
        qd: Array,
        grip_m: float,
        odometry: Vector,
        dt_s: float,
    ) -> tuple[CheckedEffort, float]:
        """Effort and wanted opening of the fingers, m, for one tick.

        Args:
            law: what the law wants at this tick; asked for while the hand holds.
            q, qd: joints, (n,) rad, rad/s.
            grip_m: how far the fingers are open.
            odometry: as in :class:`wire.messages.State`.
            dt_s: time since the tick before.
        """
        share = remaining_offset(self._elapsed_s, self._let_down_s)
        self._elapsed_s += dt_s
        if self.phase is Phase.LET_DOWN:
            if share:
                return self._faded(law(), share, q, qd), 0.0
            self.phase = Phase.OPEN
        motion = self._motion or self._begin(q, grip_m)
        base, rate = np.array(odometry[:3]), np.array(odometry[3:])
        if not self._is_loose:
            if grip_m < min(self._closed_m + TOUCH_M, OPEN_M):
                held = motion.effort(q, qd)
                return CheckedEffort(held.torque, self._base_force, held.stiffness), OPEN_M
            self._is_loose = True
            motion.speed = rate.copy()
            motion.speed[:2] += (self._arm.hand(q)[2] @ qd)[:2]  # as the hand, and so the load, goes
        if self.phase is Phase.OPEN and grip_m >= min(self._closed_m + LOOSE_M, OPEN_M):
            self.phase = Phase.LIFT
        if self.phase is Phase.LIFT and motion.move_hand(self._up, self._R_hand, dt_s):
            self._aim = base + planar(base[2]) @ np.array([-BACK_M, 0.0, 0.0])
            self.phase = Phase.DRIVE
        elif self.phase in (Phase.DRIVE, Phase.CLEAR):
            motion.move_hand(self._up - np.array([DRAWN_M, 0.0, 0.0]), self._R_hand, dt_s)
            off_m, _ = motion.drive(self._aim, base, dt_s)
            if off_m < CLEAR_M and float(np.abs(rate).max()) < SLOW_M_S:
                self.phase = Phase.CLEAR
        return motion.effort(q, qd, rate), OPEN_M

    def _begin(self, q: Array, grip_m: float) -> Motion:
        place, self._R_hand, _ = self._arm.hand(q)
        self._up = place + np.array([0.0, 0.0, LIFT_M])
        self._motion, self._closed_m = Motion(self._arm, q), grip_m
        return self._motion

    def _faded(self, wanted: CheckedEffort, share: float, q: Array, qd: Array) -> CheckedEffort:
        """So much of the law's torque, and for the rest what bears the arm alone; the base goes on following."""
        self._base_force = wanted.base_force
        limp = (1.0 - share) * (self._arm.gravity(q) - LIMP_NMS_RAD * qd)
        return CheckedEffort(
            tuple((share * np.array(wanted.torque) + limp).tolist()),
            wanted.base_force,
            tuple(share * each for each in wanted.stiffness),
        )
