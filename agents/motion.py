"""An arm and a base that go where they shall, while the hand carries nothing: what reaching and retreating share.

The arm is held by stiff joints whose wanted positions follow the hand's aim; the base is driven by its odometry.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.safety import CheckedEffort, limit_torque
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]

HAND_M_S, HAND_RAD_S, HAND_1_S = 0.15, 0.6, 5.0
"""Speed limits of the hand, and the rate at which it goes to its aim."""
SETTLED_M, SETTLED_RAD = 0.002, 0.01
DRIVE = (0.4, 0.5, 2.0, 0.5)
"""Base: speed limits m/s and rad/s, the rate at which it goes to its aim 1/s, and the change of speed m/s^2."""
BASE_DAMPING = np.array([20_000.0, 20_000.0, 2_000.0])
"""Towards the wanted speed of the base: N s/m, N m s/rad."""
BASE_MAX = np.array([1000.0, 1000.0, 200.0])
"""What is asked of the base's drive at most: N, N, N m."""
JOINT_NM_RAD, JOINT_NMS_RAD = 400.0, 30.0
"""Stiffness and damping of the proximal joints; those of the wrist are smaller by :data:`WRIST`."""
WRIST = 0.3
IK_DAMPING = 0.02


class Motion:
    """Arm and base of one robot, tick by tick.

    Args:
        arm: the model.
        q: joints now, (n,) rad: they are held there until :meth:`move_hand`.
    """

    def __init__(self, arm: ArmModel, q: Array) -> None:
        self._arm, self._q = arm, q.copy()
        wrist = np.where(np.arange(arm.joints) < arm.joints - 3, 1.0, WRIST)
        self._torque_max = arm_limits(arm.name).torque_Nm
        self._K, self._D = JOINT_NM_RAD * wrist, JOINT_NMS_RAD * wrist
        self.speed = np.zeros(3)
        """Wanted velocity of the base in its own frame, (3,) m/s, m/s, rad/s."""

    def move_hand(self, p: Array, R: Array, dt_s: float) -> bool:
        """Move the wanted joints so that the hand goes to this pose, in the arm's base frame; whether it is there."""
        p_here, R_here, J = self._arm.hand(self._q)
        off, turned = p - p_here, rotation_vector(R @ R_here.T)
        v = np.concatenate([limited(HAND_1_S * off, HAND_M_S), limited(HAND_1_S * turned, HAND_RAD_S)])
        self._q = self._q + dt_s * (J.T @ np.linalg.solve(J @ J.T + IK_DAMPING**2 * np.eye(6), v))
        return float(np.linalg.norm(off)) < SETTLED_M and float(np.linalg.norm(turned)) < SETTLED_RAD

    def drive(self, aim: Array, base: Array, dt_s: float) -> tuple[float, float]:
        """Set the wanted speed of the base towards a place; how far off it is, m and rad.

        Args:
            aim, base: where it shall stand and stands: x, y [m], yaw [rad] of the odometry, (3,) each.
            dt_s: time since the tick before.
        """
        v_max, w_max, gain, change = DRIVE
        away = aim - base
        away[2] = math.remainder(away[2], math.tau)
        wanted = gain * (planar(-base[2]) @ away)
        speed = float(np.hypot(wanted[0], wanted[1]))
        wanted[:2] *= min(1.0, v_max / max(speed, 1e-9))
        wanted[2] = min(max(gain * away[2], -w_max), w_max)
        self.speed += np.clip(wanted - self.speed, -change * dt_s, change * dt_s)
        return float(np.hypot(away[0], away[1])), abs(float(away[2]))

    def effort(self, q: Array, qd: Array, rate: Array | None = None) -> CheckedEffort:
        """Torques that hold the arm at its wanted joints, and the force that gives the base its wanted speed.

        Args:
            q, qd: joints, (n,) rad, rad/s.
            rate: velocity of the base in its own frame, (3,) m/s, m/s, rad/s; None: the base rolls freely.
        """
        torque = self._arm.gravity(q) + self._K * (self._q - q) - self._D * qd
        force = np.zeros(3) if rate is None else np.clip(BASE_DAMPING * (self.speed - rate), -BASE_MAX, BASE_MAX)
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
