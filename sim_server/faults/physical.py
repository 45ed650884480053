"""What all physical faults share: on what they act, and the moments at which they may: sense, drive, shape, watch.

A fault never touches an agent: it changes what a sensor says, what a drive gives, or a number of MuJoCo's model, and
looks afterwards at what has come of it. All that it is to remember is plain numbers, for the checkpoint.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from sim_server.faults.event import Lasting
from sim_server.snapshot import Snapshot

if TYPE_CHECKING:  # the world knows the scenario, which knows all faults
    from sim_server.world import ArmIds, World

Array = NDArray[np.float64]


class PhysicalEvent(Lasting):
    """A fault in the simulated world."""


class ArmEvent(PhysicalEvent):
    """A fault of one robot."""

    arm: str


class PhysicalEffect(ABC):
    """A physical fault that goes on.

    Args:
        event: its settings.
        seed: the scenario's.
        number: of the fault in its run; each draws anew.
        begin: its first tick.
        end: the tick at which it is over; None: never.
    """

    shapes: ClassVar[bool] = False
    """Whether it changes numbers of the model."""
    moves: ClassVar[bool] = False
    """Whether it changes them anew in every physics step."""
    changes_inertia: ClassVar[bool] = False
    """Whether masses are among them."""

    def __init__(self, event: PhysicalEvent, seed: int, number: int, begin: int, end: int | None) -> None:
        self.event, self.number, self.begin, self.end = event, number, begin, end
        self._seed = seed
        self.told = False
        """Whether it has been reported that it takes effect."""

    def sense(self, reading: Array, tick: int) -> None:
        """Change what the robot's sensors say in this tick, in place: [q, qd, tau, wrench], (3n + 6,)."""

    def drive(self, torque: Array, base_force: Array) -> None:
        """Change what the robot's drives give, in place: (n,) N m and (3,) N, N, N m, of what they mean to give."""

    def shape(self, world: World, elapsed_s: float) -> None:
        """Change numbers of the model, which are as they were compiled, or as faults before this one have left them."""

    def watch(self, world: World, tick: int) -> None:
        """Look at what has come of it, after the physics of a tick."""

    def is_over(self, tick: int, elapsed_s: float) -> bool:
        """Whether nothing of it is left in this tick."""
        return self.end is not None and tick >= self.end

    @property
    def seen(self) -> str:
        """What shows that it takes effect; nothing until that is seen."""
        return self.count

    @property
    @abstractmethod
    def count(self) -> str:
        """What has been seen so far, in numbers; nothing if that is nothing."""

    def state(self) -> Snapshot:
        """What it remembers."""
        return {}

    def restore(self, saved: Snapshot) -> None:
        """Go on from there."""


def of(world: World, event: PhysicalEvent) -> ArmIds:
    """The addresses of the robot that a fault is on."""
    return world.arms[str(event.arm)]
