"""What stands between a control law and the wire: limits, a check of what it returned, the take-over, and the hold."""

from __future__ import annotations

from math import isfinite

import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.controllers.interface import Controller, Effort, Sensed
from agents.errors import ControllerError
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]


def limit_torque(torque: Array, torque_max: Array) -> Array:
    """Clip joint torques, (n,) N m, to +-torque_max, (n,) N m."""
    return np.minimum(np.maximum(torque, -torque_max), torque_max)


def hold_effort(arm: ArmModel, q: Array) -> Effort:
    """What an agent asks for when its senses are gone: gravity at the last known q, (n,) rad, and a base at rest.

    No stiffness and no damping: both would act on old positions and velocities.
    """
    g = arm.snapshot(q, np.zeros(arm.joints)).g
    return Effort(torque=g, base_force=np.zeros(3), stiffness=np.zeros(arm.joints))


def remaining_offset(elapsed_s: float, handover_s: float) -> float:
    """How much of the torque at take-over is still added, 1 at the start to 0 after ``handover_s``, smoothly."""
    if elapsed_s >= handover_s:
        return 0.0
    s = elapsed_s / handover_s
    return 1.0 - s * s * (3.0 - 2.0 * s)


class SafeController:
    """A control law that takes over without a bump and whose output is checked and limited to what the arm takes.

    At take-over the arm already carries something with the torque it measures. What the law does not know of that is
    added to its output and fades over ``handover_s`` (bumpless transfer; ours, not the paper's). The rate limit
    (1000 N m/s) is kept by the motor driver, which alone knows what it applied last.
    """

    def __init__(self, name: str, controller: Controller, arm: ArmModel, handover_s: float) -> None:
        self._name, self._controller = name, controller
        self._joints = arm.joints
        self._handover_s = handover_s
        self._elapsed_s = 0.0
        self._offset: Array | None = None
        self._torque_max = np.array(arm_limits(arm.name).torque_Nm)

    def step(self, sensed: Sensed, dt_s: float) -> Effort:
        """The law's effort within the arm's torque limits.

        Raises:
            ControllerError: the law raised, or returned something of the wrong shape or not finite.
        """
        try:
            effort = self._controller.step(sensed, dt_s)
        except Exception as error:  # a user's code may raise anything; the cause goes to the log with its traceback
            raise ControllerError(f"controller {self._name} failed: {type(error).__name__}: {error}") from error
        for what, values, size in (
            ("torque", effort.torque, self._joints),
            ("base_force", effort.base_force, 3),
            ("stiffness", effort.stiffness, self._joints),
        ):
            if not isinstance(values, np.ndarray) or values.shape != (size,):
                raise ControllerError(
                    f"controller {self._name}: {what}: got {type(values).__name__} of shape {np.shape(values)}, "
                    f"expected a numpy array of shape ({size},)"
                )
            if not isfinite(values.sum()):  # a sum is finite only if all its terms are
                raise ControllerError(f"controller {self._name}: {what}: got {values}, expected finite numbers")
        if self._offset is None:
            self._offset = sensed.tau - effort.torque
        else:
            self._elapsed_s += dt_s
        torque = effort.torque + remaining_offset(self._elapsed_s, self._handover_s) * self._offset
        return Effort(limit_torque(torque, self._torque_max), effort.base_force, effort.stiffness)
