"""What a motor driver does by itself with an arm that nobody commands: go limp, brake, open the hand, let down.

A driver knows what a real one knows: its joints, the torque that holds the arm itself up, its wheels' odometry. No
load, no other arm. Each behaviour starts from the torque applied at that moment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim_server.snapshot import Snapshot, SnapshotError

Array = NDArray[np.float64]

LIMP_DAMPING_NMS_RAD = 5.0
"""Joint damping of an arm that is limp."""
BRAKE_NM_RAD, BRAKE_NMS_RAD = 600.0, 30.0
BRAKE_BASE = (np.array([20_000.0, 20_000.0, 4_000.0]), np.array([4_000.0, 4_000.0, 400.0]))
"""Stiffness and damping of a braked base: N/m, N m/rad; N s/m, N m s/rad."""
HOLD_NM_RAD, HOLD_NMS_RAD = 200.0, 20.0
"""Joint stiffness and damping of an empty arm that draws back; of a 0.1 kg m^2 joint, well damped."""
DRAW_BACK_RAD = -0.5
"""Turn of the second joint (the shoulder) that takes the Panda's hand 0.25 m up and 0.08 m back."""
DRAW_BACK_S = 2.0
BACK_OFF_M, BACK_OFF_M_S = 1.2, 0.3
"""How far and how fast the base of an arm that left drives backward once its hand is up."""
STOP_BASE = np.array([2_000.0, 2_000.0, 200.0])
"""Damping towards the wanted base velocity: N s/m, N m s/rad."""


@dataclass(frozen=True, slots=True)
class Felt:
    """What the drivers of N arms measure themselves."""

    gravity: Array
    """Torques that hold the arms themselves up, (N, n) N m."""
    q: Array
    qd: Array
    """Joint positions and velocities, (N, n) rad, rad/s."""
    base: Array
    base_rate: Array
    """Odometry: x, y, yaw of the bases and their rates in the frame that the odometry started in, (N, 3) m, rad."""

    def of(self, arm: int) -> FeltByOne:
        """One arm's part."""
        return FeltByOne(self.gravity[arm], self.q[arm], self.qd[arm], self.base[arm], self.base_rate[arm])


@dataclass(frozen=True, slots=True)
class FeltByOne:
    """The same of one arm: (n,) and (3,)."""

    gravity: Array
    q: Array
    qd: Array
    base: Array
    base_rate: Array

    def in_base(self, vector: Array) -> Array:
        """A vector x, y, yaw of the odometry's frame, in the base's frame B."""
        c, s = np.cos(self.base[2]), np.sin(self.base[2])
        return np.array([c * vector[0] + s * vector[1], c * vector[1] - s * vector[0], vector[2]])


class Behaviour(Protocol):
    """Torque and base force of an arm without commands, step by step."""

    @property
    def holds(self) -> bool:
        """Whether the hand stays closed."""
        ...

    def step(self, felt: FeltByOne, torque: Array, dt_s: float) -> tuple[Array, Array]:
        """Torque (n,) N m and base force (3,) in B; ``torque`` is what is applied now."""
        ...

    def state(self) -> Snapshot:
        """Which behaviour, and how far it has come: for :func:`behaviour_of`."""
        ...


class Limp:
    """Gravity compensated and damped; the base rolls freely."""

    holds = True

    def step(self, felt: FeltByOne, torque: Array, dt_s: float) -> tuple[Array, Array]:
        return felt.gravity - LIMP_DAMPING_NMS_RAD * felt.qd, np.zeros(3)

    def state(self) -> Snapshot:
        return {"kind": "limp"}


class Brake:
    """Joints and base stay where they are, and go on bearing what they bore."""

    holds = True

    def __init__(self) -> None:
        self._start: tuple[Array, Array, Array] | None = None

    def step(self, felt: FeltByOne, torque: Array, dt_s: float) -> tuple[Array, Array]:
        if self._start is None:
            self._start = felt.q.copy(), felt.base.copy(), torque - felt.gravity
        q, base, borne = self._start
        stiffness, damping = BRAKE_BASE
        force = felt.in_base(stiffness * (base - felt.base) - damping * felt.base_rate)
        return felt.gravity + borne + BRAKE_NM_RAD * (q - felt.q) - BRAKE_NMS_RAD * felt.qd, force

    def state(self) -> Snapshot:
        return {"kind": "brake", "start": self._start}

    @classmethod
    def of(cls, saved: Snapshot) -> Brake:
        behaviour = cls()
        if saved["start"] is not None:
            q, base, borne = saved["start"]
            behaviour._start = q, base, borne
        return behaviour


class Release:
    """The hand opens, the arm draws up and back, the base stops; with ``back_off_m`` it then drives clear."""

    holds = False

    def __init__(self, back_off_m: float = 0.0) -> None:
        self._back_off_s = back_off_m / BACK_OFF_M_S
        self._q: Array | None = None
        self._elapsed_s = 0.0

    def step(self, felt: FeltByOne, torque: Array, dt_s: float) -> tuple[Array, Array]:
        if self._q is None:
            self._q = felt.q.copy()
        wanted = self._q.copy()
        wanted[1] += DRAW_BACK_RAD * smooth(self._elapsed_s / DRAW_BACK_S)
        speed = np.zeros(3)
        if DRAW_BACK_S <= self._elapsed_s < DRAW_BACK_S + self._back_off_s:
            speed[0] = -BACK_OFF_M_S
        self._elapsed_s += dt_s
        force = STOP_BASE * (speed - felt.in_base(felt.base_rate))
        return felt.gravity + HOLD_NM_RAD * (wanted - felt.q) - HOLD_NMS_RAD * felt.qd, force

    def state(self) -> Snapshot:
        return {"kind": "release", "back_off_s": self._back_off_s, "q": self._q, "elapsed_s": self._elapsed_s}

    @classmethod
    def of(cls, saved: Snapshot) -> Release:
        behaviour = cls()
        behaviour._back_off_s = float(saved["back_off_s"])
        behaviour._q, behaviour._elapsed_s = saved["q"], float(saved["elapsed_s"])
        return behaviour


class LetDown:
    """After a goodbye: what the arm bore fades, limp, over ``leave_s``; then the hand opens and all drive clear."""

    def __init__(self, leave_s: float) -> None:
        self._leave_s = leave_s
        self._borne: Array | None = None
        self._elapsed_s = 0.0
        self._limp, self._after = Limp(), Release(BACK_OFF_M)

    @property
    def holds(self) -> bool:
        return self._elapsed_s < self._leave_s

    def step(self, felt: FeltByOne, torque: Array, dt_s: float) -> tuple[Array, Array]:
        if not self.holds:
            return self._after.step(felt, torque, dt_s)
        limp, force = self._limp.step(felt, torque, dt_s)
        if self._borne is None:
            self._borne = torque - limp
        share = 1.0 - smooth(self._elapsed_s / self._leave_s)
        self._elapsed_s += dt_s
        return limp + share * self._borne, force

    def state(self) -> Snapshot:
        after = self._after.state()
        elapsed = {"leave_s": self._leave_s, "elapsed_s": self._elapsed_s}
        return {"kind": "let_down", "borne": self._borne, "after": after, **elapsed}

    @classmethod
    def of(cls, saved: Snapshot) -> LetDown:
        behaviour = cls(float(saved["leave_s"]))
        behaviour._borne, behaviour._elapsed_s = saved["borne"], float(saved["elapsed_s"])
        behaviour._after = Release.of(saved["after"])
        return behaviour


_OF: Mapping[str, Callable[[Snapshot], Behaviour]] = {
    "limp": lambda saved: Limp(),
    "brake": Brake.of,
    "release": Release.of,
    "let_down": LetDown.of,
}


def behaviour_of(saved: Snapshot) -> Behaviour:
    """The behaviour whose :meth:`Behaviour.state` this is, as far along as it was."""
    if saved["kind"] not in _OF:
        raise SnapshotError(f"behaviour: got {saved['kind']!r}, expected one of {', '.join(_OF)}")
    return _OF[saved["kind"]](saved)


def smooth(s: float) -> float:
    """From 0 at 0 to 1 at 1 and beyond, with no speed at either end."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)
