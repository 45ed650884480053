"""What the server needs of a plant: the border between the wire and whatever moves, a simulation or real arms.

The state that agents get comes from :meth:`Plant.read` alone, so nothing that only a simulator knows can slip in.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from wire.messages import Vector

Array = NDArray[np.float64]
Numbers = Vector | Array


class Reading(Struct, frozen=True, gc=False):
    """What the sensors of one arm say; fields as in :class:`wire.messages.State`."""

    q: Vector
    qd: Vector
    tau: Vector
    wrench: Vector
    grip_m: float
    odometry: Vector


class LoadPose(Struct, frozen=True, gc=False):
    """Where the load's frame O is and how it moves, in the world frame."""

    position: Array
    """(3,) m."""
    quat_wxyz: Array
    """(4,)."""
    linear_velocity: Array
    """(3,) m/s, of the origin of O."""
    angular_velocity: Array
    """(3,) rad/s, world frame."""


class Plant(Protocol):
    """The robots' drivers and sensors, the load, and time."""

    def read(self) -> Mapping[str, Reading]:
        """Sensor readings of all arms at this tick; drawn once per tick."""
        ...

    def load_pose(self) -> LoadPose: ...

    def pull(self, point: str, force: Array) -> None:
        """The leader's force, (3,) N world, at a named point of the load; held until the next one."""
        ...

    def command(
        self,
        arm: str,
        torque: Numbers,
        base_force: Numbers,
        stiffness: Numbers,
        grip_m: float = 0.0,
        residual_W: float = 0.0,
    ) -> None:
        """This tick's command for one arm (``stiffness`` and ``residual_W`` are recorded only); an arm without one has
        missed the tick."""
        ...

    @property
    def carry_height_m(self) -> float:
        """How high above the arms' own base frames the hands carry."""
        ...

    def reach(self, arm: str) -> Vector:
        """Where the strut of this arm is, for :class:`wire.messages.Welcome`; its odometer begins now."""
        ...

    def lose(self, arm: str) -> str:
        """Its agent is gone or does not answer. Returns what the arm does now, in a word."""
        ...

    def let_down(self, arm: str, *, retreated: bool) -> None:
        """Its agent has said goodbye. ``retreated``: after it had said that it was leaving."""
        ...

    def regain(self, arm: str) -> None: ...

    def prepare(self) -> None:
        """Whatever of the next step needs no command; called while the agents compute. May do nothing."""
        ...

    def step(self) -> None:
        """Advance to the next tick."""
        ...
