"""What stands between a control law and the wire: limits, a check of what it returned, the take-over, and the hold.

In plain numbers: numpy is slower on seven of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.controllers.interface import CarriesAt, Controller, Effort, Sensed
from agents.errors import ControllerError
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]
Numbers = tuple[float, ...]


class CheckedEffort(Struct, frozen=True, gc=False):
    """An :class:`agents.controllers.interface.Effort` that may go to the motors: complete, finite, within limits."""

    torque: Numbers
    base_force: Numbers
    stiffness: Numbers
    residual_W: float = 0.0


def limit_torque(torque: Sequence[float], torque_max: Sequence[float]) -> Numbers:
    """Clip joint torques, (n,) N m, to +-torque_max, (n,) N m."""
    return tuple([min(max(tau, -most), most) for tau, most in zip(torque, torque_max, strict=True)])


def hold_effort(arm: ArmModel, q: Array) -> CheckedEffort:
    """What an agent asks for when its senses are gone: gravity at the last known q, (n,) rad, and a base at rest.

    No stiffness and no damping: both would act on old positions and velocities.
    """
    g = arm.snapshot(q, np.zeros(arm.joints)).g
    return CheckedEffort(torque=tuple(g.tolist()), base_force=(0.0,) * 3, stiffness=(0.0,) * arm.joints)


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
        self._offset: list[float] | None = None
        self._torque_max = arm_limits(arm.name).torque_Nm

    def carry_at(self, height_m: float) -> None:
        """Tell the law where to carry, if it wants to know."""
        if isinstance(self._controller, CarriesAt):
            self._controller.carry_at(height_m)

    def step(self, sensed: Sensed, dt_s: float) -> CheckedEffort:
        """The law's effort within the arm's torque limits.

        Raises:
            ControllerError: the law raised, or returned something of the wrong shape or not finite.
        """
        try:
            effort = self._controller.step(sensed, dt_s)
        except Exception as error:  # a user's code may raise anything; the cause goes to the log with its traceback
            raise ControllerError(f"controller {self._name} failed: {type(error).__name__}: {error}") from error
        if not isinstance(effort, Effort):
            raise ControllerError(
                f"controller {self._name}: step: got {type(effort).__name__}, expected an Effort (a return forgotten?)"
            )
        torque = self._checked("torque", effort.torque, self._joints)
        base_force = self._checked("base_force", effort.base_force, 3)
        stiffness = self._checked("stiffness", effort.stiffness, self._joints)
        if self._offset is None:
            self._offset = [there - wanted for there, wanted in zip(sensed.tau.tolist(), torque, strict=True)]
        else:
            self._elapsed_s += dt_s
        share = remaining_offset(self._elapsed_s, self._handover_s)
        if share:
            torque = [wanted + share * offset for wanted, offset in zip(torque, self._offset, strict=True)]
        if not isinstance(effort.residual_W, float) or not isfinite(effort.residual_W):
            raise ControllerError(
                f"controller {self._name}: residual_W: got {effort.residual_W!r}, expected a finite float"
            )
        torque_within = limit_torque(torque, self._torque_max)
        return CheckedEffort(torque_within, tuple(base_force), tuple(stiffness), effort.residual_W)

    def _checked(self, what: str, values: Array, size: int) -> list[float]:
        """The numbers in ``values``. Raises :class:`ControllerError` if they are not ``size`` finite ones."""
        if not isinstance(values, np.ndarray) or values.shape != (size,):
            shape = f" of shape {values.shape}" if isinstance(values, np.ndarray) else ""
            raise ControllerError(
                f"controller {self._name}: {what}: got {type(values).__name__}{shape}, expected a numpy array of shape "
                f"({size},)"
            )
        if values.dtype.kind not in "fiu":
            raise ControllerError(
                f"controller {self._name}: {what}: got an array of {values.dtype}, expected one of real numbers"
            )
        numbers: list[float] = values.tolist()
        if not isfinite(sum(numbers)):  # a sum is finite only if all its terms are
            raise ControllerError(f"controller {self._name}: {what}: got {values}, expected finite numbers")
        return numbers
