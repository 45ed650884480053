"""Sensors that are off, noisy, silent now and then, or frozen, and a wrist that feels nothing any more.

A reading is [q, qd, tau, force, moment] of one arm, after the plant's own noise. What an agent gets is still a whole
message of finite numbers: a value that is missing reads zero, as from a converter without input.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Literal

import numpy as np

from sim_server.faults.event import Fault, Finite, Joint, NotNegative, Probability
from sim_server.faults.physical import ArmEvent, Array, PhysicalEffect, PhysicalEvent
from sim_server.snapshot import Snapshot

STREAM = 0x5E250
"""Keeps these draws apart from all others of the same seed."""
SIZES = ("position_rad", "velocity_rad_s", "torque_Nm", "wrench_N", "wrench_Nm")
"""Settings of a fault of all channels."""
UNITS = ("rad", "rad/s", "N m", "N", "N m at the wrist")
CHANNELS = ("q", "qd", "tau", "wrench")

Channel = Literal["q", "qd", "tau", "wrench"]


class _OfAllChannels(ArmEvent):
    joint: Joint | None = None
    """Whose position, velocity and torque; without it all joints'."""

    def problem(self) -> tuple[str, str] | None:
        return None if any(_sizes(self)) else NOTHING


class SensorBias(_OfAllChannels):
    """Readings that are off by a constant."""

    kind: Literal["sensor_bias"]
    position_rad: Finite = 0.0
    velocity_rad_s: Finite = 0.0
    torque_Nm: Finite = 0.0
    wrench_N: Finite = 0.0
    """On each of the three forces of the wrist, and"""
    wrench_Nm: Finite = 0.0
    """on each of its moments."""


class SensorNoise(_OfAllChannels):
    """Readings with more noise: normal, one standard deviation each, drawn anew in every tick."""

    kind: Literal["sensor_noise"]
    position_rad: NotNegative = 0.0
    velocity_rad_s: NotNegative = 0.0
    torque_Nm: NotNegative = 0.0
    wrench_N: NotNegative = 0.0
    wrench_Nm: NotNegative = 0.0


NOTHING = "position_rad", f"nothing is changed: expected one of {', '.join(SIZES)} that is not 0"


class _OfAChannel(ArmEvent):
    channel: Channel
    joint: Joint | None = None
    """Of which joint; without it all of the channel."""

    def problem(self) -> tuple[str, str] | None:
        if self.channel == "wrench" and self.joint is not None:
            return "joint", f"{self.joint}: the wrench is not a joint's; leave it out"
        return None


class SensorDropout(_OfAChannel):
    """Readings that are missing in some ticks, and then are zero."""

    kind: Literal["sensor_dropout"]
    probability: Probability = 0.1
    """Of each tick."""


class SensorFrozen(_OfAChannel):
    """Readings that stay as they were in the fault's first tick."""

    kind: Literal["sensor_frozen"]


class WristDead(ArmEvent):
    """A wrist sensor that reads zero."""

    kind: Literal["wrist_dead"]


class _Off(PhysicalEffect):
    """Readings that are not what the sensors say: in how many ticks, and by how much."""

    _ticks = 0
    _most: tuple[float, ...] = (0.0,) * 5

    @abstractmethod
    def wrong(self, reading: Array, tick: int) -> Array:
        """The reading that goes out instead, the callee's own."""

    def sense(self, reading: Array, tick: int) -> None:
        wrong = self.wrong(reading, tick)
        off = np.abs(wrong - reading)
        if off.any():
            self._ticks += 1
            parts = np.split(off, _borders(len(off)))
            self._most = tuple(max(most, float(part.max())) for most, part in zip(self._most, parts, strict=True))
        reading[:] = wrong

    @property
    def count(self) -> str:
        if not self._ticks:
            return ""
        sizes = ", ".join(f"{most:.3g} {unit}" for most, unit in zip(self._most, UNITS, strict=True) if most)
        return f"readings of {self._ticks} ticks were off, by {sizes} at most"

    def state(self) -> Snapshot:
        return {"ticks": self._ticks, "most": list(self._most)}

    def restore(self, saved: Snapshot) -> None:
        self._ticks, self._most = int(saved["ticks"]), tuple(float(most) for most in saved["most"])


class SensorBiasEffect(_Off):
    event: SensorBias

    def wrong(self, reading: Array, tick: int) -> Array:
        found: Array = reading + _spread(_sizes(self.event), self.event.joint, len(reading))
        return found


class SensorNoiseEffect(_Off):
    event: SensorNoise

    def wrong(self, reading: Array, tick: int) -> Array:
        sigma = _spread(_sizes(self.event), self.event.joint, len(reading))
        rng = np.random.default_rng([self._seed, STREAM, self.number, tick])
        found: Array = reading + sigma * rng.standard_normal(len(reading))
        return found


class SensorDropoutEffect(_Off):
    event: SensorDropout

    def wrong(self, reading: Array, tick: int) -> Array:
        found = reading.copy()
        rng = np.random.default_rng([self._seed, STREAM, self.number, tick])
        if rng.random() < self.event.probability:
            found[_where(self.event.channel, self.event.joint, len(reading))] = 0.0
        return found


class SensorFrozenEffect(_Off):
    event: SensorFrozen
    _kept: Array | None = None

    def wrong(self, reading: Array, tick: int) -> Array:
        where = _where(self.event.channel, self.event.joint, len(reading))
        if self._kept is None:
            self._kept = reading[where].copy()
        found = reading.copy()
        found[where] = self._kept
        return found

    def state(self) -> Snapshot:
        return super().state() | {"kept": self._kept}

    def restore(self, saved: Snapshot) -> None:
        super().restore(saved)
        self._kept = saved["kept"]


class WristDeadEffect(_Off):
    def wrong(self, reading: Array, tick: int) -> Array:
        found = reading.copy()
        found[-6:] = 0.0
        return found


def _sizes(event: _OfAllChannels) -> tuple[float, ...]:
    return tuple(float(getattr(event, name)) for name in SIZES)


def _borders(width: int) -> list[int]:
    joints = (width - 6) // 3
    return [joints, 2 * joints, 3 * joints, 3 * joints + 3]


def _spread(sizes: tuple[float, ...], joint: int | None, width: int) -> Array:
    """Each size where its numbers are in a reading, (width,); those of joints at one of them only, if that is given."""
    joints = (width - 6) // 3
    spread = np.repeat(sizes, [joints] * 3 + [3, 3])
    if joint is not None:
        others = np.arange(3 * joints) % joints != joint - 1
        spread[: 3 * joints][others] = 0.0
    return spread


def _where(channel: Channel, joint: int | None, width: int) -> slice:
    """Where a channel, or one joint of it, is in a reading."""
    joints = (width - 6) // 3
    start = joints * CHANNELS.index(channel)
    if channel == "wrench":
        return slice(start, width)
    return slice(start, start + joints) if joint is None else slice(start + joint - 1, start + joint)


FAULTS = (
    Fault(
        "sensor_bias",
        "physical",
        SensorBias,
        "readings are off by what is given, of `joint` or of all joints",
        "in how many ticks readings were off, by how much at most",
    ),
    Fault(
        "sensor_noise",
        "physical",
        SensorNoise,
        "readings have so much more noise (one standard deviation)",
        "in how many ticks readings were off, by how much at most",
    ),
    Fault(
        "sensor_dropout",
        "physical",
        SensorDropout,
        "readings of `channel` are missing in a tick with `probability`, and are 0 then",
        "in how many ticks readings were off, by how much at most",
    ),
    Fault(
        "sensor_frozen",
        "physical",
        SensorFrozen,
        "readings of `channel` stay what they were",
        "in how many ticks readings were off, by how much at most",
    ),
    Fault(
        "wrist_dead",
        "physical",
        WristDead,
        "the wrist's force and moment read 0",
        "in how many ticks readings were off, by how much at most",
    ),
)
EFFECTS: Mapping[type[PhysicalEvent], type[PhysicalEffect]] = {
    SensorBias: SensorBiasEffect,
    SensorNoise: SensorNoiseEffect,
    SensorDropout: SensorDropoutEffect,
    SensorFrozen: SensorFrozenEffect,
    WristDead: WristDeadEffect,
}
