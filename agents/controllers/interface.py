"""What a controller is: ``step(sensed, dt_s) -> Effort``. No clock, no socket, nothing of any other robot."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from agents.arm_model import ArmModel

Array = NDArray[np.float64]


class Sensed(Struct, frozen=True, gc=False):
    """What one arm feels at one instant."""

    q: Array
    """Joint positions, (n,) rad."""
    qd: Array
    """Joint velocities, (n,) rad/s."""
    tau: Array
    """Measured joint torques, (n,) N m."""
    wrench: Array
    """Wrist wrench [force; torque], (6,) N and N m: the arm on the hand, in the wrist frame."""


class Effort(Struct, frozen=True, gc=False):
    """What a controller wants."""

    torque: Array
    """Joint torques, (n,) N m, gravity included."""
    base_force: Array
    """(3,) force x, y in N and yaw torque in N m on the mobile base, in the base frame B."""
    stiffness: Array
    """(n,) present joint stiffness, N m/rad: a report for the record, nobody obeys it."""
    residual_W: float = 0.0
    """Passivity residual, a report too: power that the law put into the hand beyond what its springs gave back and its
    dampers took. 0 from a law that does not keep account of it."""


class Controller(Protocol):
    """A control law with its memory. Built as ``Class(arm, **gains)``; gains come from the scenario or ``--set``."""

    def step(self, sensed: Sensed, dt_s: float) -> Effort:
        """The effort at this instant; ``dt_s`` is the simulated time since the step before (one period at first)."""
        ...


@runtime_checkable
class CarriesAt(Protocol):
    """A controller that can be told where to carry. One that has no such method carries where its hand is when it takes
    over."""

    def carry_at(self, height_m: float) -> None:
        """Carry with the hand pointing straight down, this high above the arm's base frame. Before the first step."""
        ...


class ControllerFactory(Protocol):
    """How a controller is made: a class whose constructor takes the arm model and the gains."""

    def __call__(self, arm: ArmModel, **gains: object) -> Controller: ...
