"""Joints and their motors: one that is stuck, that gives a part of its torque, or no more than so much."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from sim_server.faults.event import Fault, Joint, Positive
from sim_server.faults.physical import ArmEvent, Array, PhysicalEffect, PhysicalEvent, of
from sim_server.snapshot import Snapshot

if TYPE_CHECKING:
    from sim_server.world import World

STUCK_NM = 1000.0
"""Torque at which a joint that is stuck would give way: ten times what its motor has."""
STIFF_SOLREF, STIFF_SOLIMP = (0.002, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Dry friction in MuJoCo creeps; so stiff, by some microradians per second under a motor's full torque."""


class JointStuck(ArmEvent):
    """A joint that stays where it is, as with a seized gear: dry friction that no torque here overcomes."""

    kind: Literal["joint_stuck"]
    joint: Joint


class TorqueLoss(ArmEvent):
    """A motor that gives a part of the torque that its driver means it to give."""

    kind: Literal["torque_loss"]
    joint: Joint
    factor: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.5
    """What is left of it."""


class TorqueSaturation(ArmEvent):
    """A motor with a lower limit, of which its driver does not know."""

    kind: Literal["torque_saturation"]
    joint: Joint
    limit_Nm: Positive = 10.0


class JointStuckEffect(PhysicalEffect):
    shapes = True
    event: JointStuck
    _start_rad: float | None = None
    _moved_rad = 0.0

    def shape(self, world: World, elapsed_s: float) -> None:
        model, dof = world.model, of(world, self.event).arm_dof.start + self.event.joint - 1
        model.dof_frictionloss[dof] = STUCK_NM
        model.dof_solref[dof], model.dof_solimp[dof] = STIFF_SOLREF, STIFF_SOLIMP

    def watch(self, world: World, tick: int) -> None:
        ids, joint = of(world, self.event), self.event.joint - 1
        q, qd = float(world.data.qpos[ids.arm_qpos][joint]), float(world.data.qvel[ids.arm_dof][joint])
        if self._start_rad is None and abs(qd) < 1e-3:  # it has come to rest
            self._start_rad = q
        if self._start_rad is not None:
            self._moved_rad = max(self._moved_rad, abs(q - self._start_rad))

    @property
    def seen(self) -> str:
        return "" if self._start_rad is None else f"joint {self.event.joint} stands at {self._start_rad:.4f} rad"

    @property
    def count(self) -> str:
        return "" if self._start_rad is None else f"{self.seen}, and has moved by {self._moved_rad:.2g} rad at most"

    def state(self) -> Snapshot:
        return {"start_rad": self._start_rad, "moved_rad": self._moved_rad}

    def restore(self, saved: Snapshot) -> None:
        self._start_rad, self._moved_rad = saved["start_rad"], float(saved["moved_rad"])


class _Cut(PhysicalEffect):
    """Less torque than the driver means to give; how much less, and in how many ticks."""

    event: TorqueLoss | TorqueSaturation
    _now_Nm = 0.0
    _ticks = 0
    _most_Nm = 0.0

    @abstractmethod
    def given(self, torque: float) -> float:
        """What the motor gives of it, N m."""

    def drive(self, torque: Array, base_force: Array) -> None:
        joint = self.event.joint - 1
        meant = float(torque[joint])
        torque[joint] = self.given(meant)
        self._now_Nm = abs(meant - float(torque[joint]))

    def watch(self, world: World, tick: int) -> None:
        self._ticks += self._now_Nm > 0.0
        self._most_Nm = max(self._most_Nm, self._now_Nm)

    @property
    def count(self) -> str:
        if not self._ticks:
            return ""
        return f"joint {self.event.joint} lacked {self._most_Nm:.3g} N m at most, in {self._ticks} ticks"

    def state(self) -> Snapshot:
        return {"ticks": self._ticks, "most_Nm": self._most_Nm}

    def restore(self, saved: Snapshot) -> None:
        self._ticks, self._most_Nm = int(saved["ticks"]), float(saved["most_Nm"])


class TorqueLossEffect(_Cut):
    event: TorqueLoss

    def given(self, torque: float) -> float:
        return self.event.factor * torque


class TorqueSaturationEffect(_Cut):
    event: TorqueSaturation

    def given(self, torque: float) -> float:
        return min(max(torque, -self.event.limit_Nm), self.event.limit_Nm)


FAULTS = (
    Fault(
        "joint_stuck",
        "physical",
        JointStuck,
        "the joint stays where it is: dry friction of 1000 N m",
        "where it stands; how far it has moved since",
    ),
    Fault(
        "torque_loss",
        "physical",
        TorqueLoss,
        "the motor gives `factor` of the torque that its driver means; `tau` is what it gives",
        "how much torque was lacking at most, in how many ticks",
    ),
    Fault(
        "torque_saturation",
        "physical",
        TorqueSaturation,
        "the motor gives `limit_Nm` at most; `tau` is what it gives",
        "how much torque was lacking at most, in how many ticks",
    ),
)
EFFECTS: Mapping[type[PhysicalEvent], type[PhysicalEffect]] = {
    JointStuck: JointStuckEffect,
    TorqueLoss: TorqueLossEffect,
    TorqueSaturation: TorqueSaturationEffect,
}
