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
from agents.safety import CheckedEffort, limit_torque
from wire.arms.limits import arm_limits
from wire.messages import Vector

Array = NDArray[np.float64]

LIFT_M = 0.10
"""How high above the strut the hand comes in."""
OPEN_M, HELD_M = 0.08, 0.005
"""Fingers wide open; and an opening below which nothing is between them."""
STILL_S = 0.1
"""Fingers that have not moved for this time have closed on something, or on nothing."""
PATIENCE_S = 60.0

HAND_M_S, HAND_RAD_S, HAND_1_S = 0.15, 0.6, 5.0
"""Speed limits of the hand, and the rate at which it goes to its aim."""
SETTLED_M, SETTLED_RAD = 0.002, 0.01
DRIVE = (0.4, 0.5, 2.0, 0.5)
"""Base: speed limits m/s and rad/s, the rate at which it goes to its aim 1/s, and the change of speed m/s^2."""
ARRIVED_M, ARRIVED_RAD, STOPPED_M_S = 0.003, 0.005, 0.005
BASE_DAMPING = np.array([20_000.0, 20_000.0, 2_000.0])
"""Towards the wanted speed of the base: N s/m, N m s/rad."""
BASE_MAX = np.array([1000.0, 1000.0, 200.0])
"""What is asked of the base's drive at most: N, N, N m."""
JOINT_NM_RAD, JOINT_NMS_RAD = 400.0, 30.0
"""Stiffness and damping of the proximal joints; those of the wrist are smaller by :data:`WRIST`."""
WRIST = 0.3
IK_DAMPING = 0.02


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
        self._began = False
        self._q = np.zeros(arm.joints)
        """Where the joints shall be."""
        self._place = np.zeros(3)
        """Where the hand is held while the base drives, in the arm's base frame."""
        self._aim = np.zeros(3)
        """Where the base shall stand: x, y, yaw of the odometry."""
        self._speed = np.zeros(3)
        self._grip_m, self._still_s, self._elapsed_s = math.inf, 0.0, 0.0
        wrist = np.where(np.arange(arm.joints) < arm.joints - 3, 1.0, WRIST)
        self._torque_max = arm_limits(arm.name).torque_Nm
        self._K, self._D = JOINT_NM_RAD * wrist, JOINT_NMS_RAD * wrist

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
        if not self._began:
            self._begin(q)
        if self.phase in (Phase.CLOSE, Phase.HOLD):  # a hand that holds is told no place any more: stay as it is
            self._close(grip_m, dt_s)
            return self._effort(q, qd, np.zeros(3)), 0.0
        base, rate = np.array(odometry[:3]), np.array(odometry[3:])
        turn = planar(-base[2])
        goal, R_goal = turn @ (self._goal - [base[0], base[1], 0.0]), turn @ self._R_goal
        arrived = self._drive(base, rate, dt_s)
        if self.phase is Phase.APPROACH:
            there = self._move_hand(np.array([*self._place[:2], goal[2] + LIFT_M]), level(R_goal), dt_s)
            if arrived and there:
                self.phase = Phase.LOWER
        elif self._move_hand(goal, R_goal, dt_s):
            self.phase = Phase.CLOSE
        return self._effort(q, qd, np.clip(BASE_DAMPING * (self._speed - rate), -BASE_MAX, BASE_MAX)), OPEN_M

    def _begin(self, q: Array) -> None:
        p, R, _ = self._arm.hand(q)
        self._began, self._q, self._place = True, q.copy(), p
        yaw = heading(self._R_goal @ R.T)
        self._aim = np.array([*(self._goal - planar(yaw) @ p)[:2], yaw])

    def _drive(self, base: Array, rate: Array, dt_s: float) -> bool:
        """Set the wanted speed of the base, in its own frame; whether it stands where it shall."""
        v_max, w_max, gain, change = DRIVE
        away = self._aim - base
        away[2] = math.remainder(away[2], math.tau)
        wanted = gain * (planar(-base[2]) @ away)
        speed = float(np.hypot(wanted[0], wanted[1]))
        wanted[:2] *= min(1.0, v_max / max(speed, 1e-9))
        wanted[2] = min(max(gain * away[2], -w_max), w_max)
        self._speed += np.clip(wanted - self._speed, -change * dt_s, change * dt_s)
        close = float(np.hypot(away[0], away[1])) < ARRIVED_M and abs(away[2]) < ARRIVED_RAD
        return close and float(np.abs(rate).max()) < STOPPED_M_S

    def _move_hand(self, p: Array, R: Array, dt_s: float) -> bool:
        """Move the wanted joint positions so that the hand goes to this pose; whether it is there."""
        p_here, R_here, J = self._arm.hand(self._q)
        off, turned = p - p_here, rotation_vector(R @ R_here.T)
        v = np.concatenate([limited(HAND_1_S * off, HAND_M_S), limited(HAND_1_S * turned, HAND_RAD_S)])
        self._q = self._q + dt_s * (J.T @ np.linalg.solve(J @ J.T + IK_DAMPING**2 * np.eye(6), v))
        return float(np.linalg.norm(off)) < SETTLED_M and float(np.linalg.norm(turned)) < SETTLED_RAD

    def _close(self, grip_m: float, dt_s: float) -> None:
        self._still_s = self._still_s + dt_s if grip_m == self._grip_m else 0.0
        self._grip_m = grip_m
        if self._still_s < STILL_S:
            return
        if grip_m < HELD_M:
            raise ReachFailed("the fingers closed on nothing: the strut is not where it was; start the agent again")
        self.phase = Phase.HOLD

    def _effort(self, q: Array, qd: Array, force: Array) -> CheckedEffort:
        torque = self._arm.gravity(q) + self._K * (self._q - q) - self._D * qd
        limited_torque = limit_torque(torque.tolist(), self._torque_max)
        return CheckedEffort(limited_torque, tuple(force.tolist()), tuple(self._K.tolist()))


def limited(vector: Array, most: float) -> Array:
    """The vector, no longer than ``most``."""
    return vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-12))


def planar(yaw: float) -> Array:
    """Rotation about z, (3, 3)."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def heading(R: Array) -> float:
    """The turn about z of a rotation that is nearly upright, rad."""
    return math.atan2(R[1, 0], R[0, 0])


def level(R: Array) -> Array:
    """The rotation of a hand that points straight down, turned about z as ``R`` is."""
    return planar(heading(R)) @ np.diag([1.0, -1.0, -1.0])


def rotation(quat_wxyz: Array) -> Array:
    """Rotation matrix of a unit quaternion, w first, (3, 3)."""
    w, x, y, z = quat_wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_vector(R: Array) -> Array:
    """Axis times angle of a rotation of less than half a turn, (3,) rad."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    s, c = float(np.linalg.norm(axis)), (float(np.trace(R)) - 1) / 2
    return axis * (math.atan2(s, c) / s if s > 1e-9 else 1.0)
