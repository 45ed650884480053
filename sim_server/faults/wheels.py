"""Bases whose wheels slip or are stuck, and a step in the floor that a base drives up."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from sim_server.faults.event import Fault, Positive
from sim_server.faults.physical import ArmEvent, Array, PhysicalEffect, PhysicalEvent, of
from sim_server.snapshot import Snapshot
from sim_server.unled_arms import smooth

if TYPE_CHECKING:
    from sim_server.world import World

WHEEL_LEVER_M = 0.3
"""Of a dragging wheel's friction about the middle of the base."""


class WheelSlip(ArmEvent):
    """Wheels that lose grip: a part of the drive's force and turning moment reaches the floor."""

    kind: Literal["wheel_slip"]
    factor: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.3
    """What is left of it."""


class WheelStuck(ArmEvent):
    """A wheel that does not turn and drags over the floor."""

    kind: Literal["wheel_stuck"]
    friction_N: Positive = 250.0
    """Its dry friction: a quarter of the robot's weight, and a friction of 1."""


class FloorStep(ArmEvent):
    """The base drives up a step; after ``for_s`` it drives down again."""

    kind: Literal["floor_step"]
    height_mm: Annotated[float, Field(strict=True, ge=-50, le=50)] = 5.0
    """Negative for a step down."""
    rise_s: Positive = 0.1
    """Time that the way up takes: 5 mm with wheels of 0.16 m take 28 mm, 0.1 s at 0.28 m/s."""

    def problem(self) -> tuple[str, str] | None:
        return None if self.height_mm else ("height_mm", "0: expected a step up or down, -50 to 50 mm")


class WheelSlipEffect(PhysicalEffect):
    event: WheelSlip
    _now_N = 0.0
    _ticks = 0
    _most_N = 0.0

    def drive(self, torque: Array, base_force: Array) -> None:
        self._now_N = (1.0 - self.event.factor) * float(np.hypot(base_force[0], base_force[1]))
        base_force *= self.event.factor

    def watch(self, world: World, tick: int) -> None:
        self._ticks += self._now_N > 0.0
        self._most_N = max(self._most_N, self._now_N)

    @property
    def count(self) -> str:
        return f"{self._most_N:.3g} N at most were lost, in {self._ticks} ticks" if self._ticks else ""

    def state(self) -> Snapshot:
        return {"ticks": self._ticks, "most_N": self._most_N}

    def restore(self, saved: Snapshot) -> None:
        self._ticks, self._most_N = int(saved["ticks"]), float(saved["most_N"])


class WheelStuckEffect(PhysicalEffect):
    shapes = True
    event: WheelStuck
    _most_N = 0.0

    def shape(self, world: World, elapsed_s: float) -> None:
        friction = self.event.friction_N
        dof = of(world, self.event).base_dof
        world.model.dof_frictionloss[dof] += np.array([friction, friction, WHEEL_LEVER_M * friction])

    def watch(self, world: World, tick: int) -> None:
        from sim_server.scene import dry_friction  # not above: it knows the scenario, which knows all faults

        dof = of(world, self.event).base_dof
        dragged = dry_friction(world.data, [dof.start, dof.start + 1])
        self._most_N = max(self._most_N, float(np.hypot(*dragged)))

    @property
    def count(self) -> str:
        return f"the wheel held the base back with {self._most_N:.3g} N at most" if self._most_N else ""

    def state(self) -> Snapshot:
        return {"most_N": self._most_N}

    def restore(self, saved: Snapshot) -> None:
        self._most_N = float(saved["most_N"])


class FloorStepEffect(PhysicalEffect):
    shapes = moves = True
    event: FloorStep
    _before_m: float | None = None
    _rise_m = 0.0

    def offset_m(self, elapsed_s: float) -> float:
        """How much higher the arm's foot stands."""
        event = self.event
        way = smooth(elapsed_s / event.rise_s)
        if event.for_s is not None:
            way -= smooth((elapsed_s - event.for_s) / event.rise_s)
        return 1e-3 * event.height_mm * way

    def shape(self, world: World, elapsed_s: float) -> None:
        world.model.body_pos[of(world, self.event).link0_body, 2] += self.offset_m(elapsed_s)

    def is_over(self, tick: int, elapsed_s: float) -> bool:
        return self.event.for_s is not None and elapsed_s >= self.event.for_s + self.event.rise_s

    def watch(self, world: World, tick: int) -> None:
        height = float(world.data.xpos[of(world, self.event).link0_body, 2])
        if self._before_m is None:
            self._before_m = height
        if abs(height - self._before_m) > abs(self._rise_m):
            self._rise_m = height - self._before_m

    @property
    def seen(self) -> str:
        return self.count if abs(self._rise_m) >= 0.99e-3 * abs(self.event.height_mm) else ""

    @property
    def count(self) -> str:
        return f"the arm's foot stood {1e3 * self._rise_m:.3g} mm higher" if self._rise_m else ""

    def state(self) -> Snapshot:
        return {"before_m": self._before_m, "rise_m": self._rise_m}

    def restore(self, saved: Snapshot) -> None:
        self._before_m, self._rise_m = saved["before_m"], float(saved["rise_m"])


FAULTS = (
    Fault(
        "wheel_slip",
        "physical",
        WheelSlip,
        "`factor` of the base drive's force and moment reaches the floor",
        "how much force was lost at most, in how many ticks",
    ),
    Fault(
        "wheel_stuck",
        "physical",
        WheelStuck,
        "dry friction of `friction_N` along x and along y of the world, and 0.3 m times that about the vertical",
        "with how much force it held the base back at most",
    ),
    Fault(
        "floor_step",
        "physical",
        FloorStep,
        "the arm's foot rises by `height_mm` within `rise_s`; see below",
        "how much higher the foot stood",
    ),
)
EFFECTS: Mapping[type[PhysicalEvent], type[PhysicalEffect]] = {
    WheelSlip: WheelSlipEffect,
    WheelStuck: WheelStuckEffect,
    FloorStep: FloorStepEffect,
}
