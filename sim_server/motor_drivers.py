"""The motor drivers of all arms and bases: the rules of a real arm's torque interface, and of nothing else.

Torque and torque-rate limits, the last command held over a missed tick, and what a lost arm does. No physics here. One
row per arm, so that many arms cost little more than one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from sim_server.snapshot import Snapshot, SnapshotError, fill
from sim_server.unled_arms import Behaviour, Felt, LetDown, behaviour_of

Array = NDArray[np.float64]


class MotorDrivers:
    """Turns commands into applied torques, step by step, for N arms with n joints.

    Args:
        start_torque: (N, n) N m, applied before the first command (the arms hold their share when the run begins).
        torque_max: (n,) N m.
        torque_rate_max: N m/s, for every joint.
        base_max: (3,) N, N, N m: bounds of a base's drive.
        delay_ticks: ticks between a command and its effect.
    """

    def __init__(
        self, start_torque: Array, torque_max: Array, torque_rate_max: float, base_max: Array, delay_ticks: int = 0
    ) -> None:
        arms, joints = start_torque.shape
        row = Struct(f"={joints + 3}d")  # writes a row in a tenth of the time that numpy takes to read a tuple
        self._pack_into, self._row_bytes = row.pack_into, row.size
        self._rate_max = torque_rate_max
        self._most = np.concatenate([torque_max, base_max])
        self.torque = start_torque.copy()
        """Torques applied now, (N, n) N m."""
        self._ages = [0] * arms
        self._given = [False] * arms
        self._unled: dict[int, Behaviour] = {}
        self._open: set[int] = set()
        # Commanded, aimed at, and within limits: rows of [torque, base force].
        self._command = np.hstack([start_torque, np.zeros((arms, 3))])
        self._target, self._limited = self._command.copy(), self._command.copy()
        self._on_the_way = deque(self._command.copy() for _ in range(delay_ticks))
        self._limited_torque = self._limited[:, :joints]
        self.base_force = self._limited[:, joints:]
        """Base forces applied now, (N, 3), each in its base frame B."""

    @property
    def age_ticks(self) -> NDArray[np.int_]:
        """Ticks since each arm's last command came, (N,)."""
        return np.array(self._ages)

    @property
    def any_unled(self) -> bool:
        """Whether :meth:`advance` needs to know what the drivers feel."""
        return bool(self._unled)

    def lets_down(self, arm: int) -> bool:
        """Whether its driver is letting its share down, and the hand still holds."""
        behaviour = self._unled.get(arm)
        return isinstance(behaviour, LetDown) and behaviour.holds

    def is_led(self, arm: int) -> bool:
        """Whether somebody commands it."""
        return arm not in self._unled

    def newly_open(self) -> list[int]:
        """Arms whose hands the drivers have opened; each is named once."""
        rows = [arm for arm, behaviour in self._unled.items() if not behaviour.holds and arm not in self._open]
        self._open.update(rows)
        return rows

    def command(self, arm: int, torque: Sequence[float] | Array, base_force: Sequence[float] | Array) -> None:
        """This tick's command of one arm: joint torque (n,) N m, base force (3,) in B."""
        self._pack_into(self._command.data, arm * self._row_bytes, *torque, *base_force)
        self._given[arm] = True

    def tick(self) -> None:
        """Close a tick: what was commanded becomes the target, after the delay; an arm without a command keeps its
        last one."""
        self._ages = [0 if given else age + 1 for given, age in zip(self._given, self._ages, strict=True)]
        self._given = [False] * len(self._given)
        self._on_the_way.append(self._command.copy())
        self._target = self._on_the_way.popleft()

    def leave_to(self, arm: int, behaviour: Behaviour) -> None:
        """Nobody commands the arm any more: it behaves by itself until somebody regains it."""
        self._unled[arm] = behaviour

    def regain(self, arm: int) -> None:
        """Somebody drives the arm again: it obeys commands, starting from the torque applied now. One that has been
        driven all along goes on with what was commanded."""
        if self._unled.pop(arm, None) is None:
            return
        self._open.discard(arm)
        for command in [self._command, *self._on_the_way]:
            command[arm] = (*self.torque[arm], 0.0, 0.0, 0.0)

    def exchange(self, rows: Sequence[int | None], start_torque: Array) -> None:
        """From now on these arms: each is an old row, or new with its row of ``start_torque``, (N, n) N m."""
        old = [row for row in rows if row is not None]
        new = {row: k for k, row in enumerate(rows) if row is not None}
        here = np.array(list(new.values()), dtype=np.intp)
        fresh = np.hstack([start_torque, np.zeros((len(rows), 3))])

        def moved(array: Array) -> Array:
            there = fresh[:, : array.shape[1]].copy()
            there[here] = array[old]
            return there

        joints = start_torque.shape[1]
        self.torque, self._command, self._target = moved(self.torque), moved(self._command), moved(self._target)
        self._limited = moved(self._limited)
        self._on_the_way = deque(moved(command) for command in self._on_the_way)
        self._limited_torque, self.base_force = self._limited[:, :joints], self._limited[:, joints:]
        self._ages = [0 if row is None else self._ages[row] for row in rows]
        self._given = [row is not None and self._given[row] for row in rows]
        self._unled = {new[row]: behaviour for row, behaviour in self._unled.items() if row in new}
        self._open = {new[row] for row in self._open if row in new}

    def advance(self, dt_s: float, felt: Felt | None = None) -> None:
        """Move the applied torques towards their targets within the limits.

        Args:
            dt_s: one physics step.
            felt: what the drivers feel themselves; needed when an arm is without commands.
        """
        target, limited = self._target, self._limited
        if felt is not None and self._unled:
            target = target.copy()
            for arm, behaviour in self._unled.items():
                target[arm, :-3], target[arm, -3:] = behaviour.step(felt.of(arm), self.torque[arm], dt_s)
        np.maximum(target, -self._most, out=limited)
        np.minimum(limited, self._most, out=limited)
        step = self._rate_max * dt_s
        change = self._limited_torque - self.torque
        np.maximum(change, -step, out=change)
        np.minimum(change, step, out=change)
        self.torque += change

    def state(self) -> Snapshot:
        """Everything that the next step depends on."""
        return {
            "torque": self.torque,
            "limited": self._limited,
            "command": self._command,
            "target": self._target,
            "on_the_way": list(self._on_the_way),
            "ages": list(self._ages),
            "unled": [[arm, behaviour.state()] for arm, behaviour in self._unled.items()],
            "open": sorted(self._open),
        }

    def restore(self, saved: Snapshot) -> None:
        """Go on from there: between two ticks, with no command given yet."""
        fill(self.torque, saved["torque"])
        fill(self._limited, saved["limited"])
        fill(self._command, saved["command"])
        fill(self._target, saved["target"])
        for command, there in zip(self._on_the_way, saved["on_the_way"], strict=True):
            fill(command, there)
        arms = range(len(self._ages))
        if len(saved["ages"]) != len(arms) or any(arm not in arms for arm, _ in saved["unled"]):
            raise SnapshotError(f"motor drivers: got other arms, expected {len(arms)}")
        self._ages = [int(age) for age in saved["ages"]]
        self._unled = {arm: behaviour_of(state) for arm, state in saved["unled"]}
        self._open = {int(arm) for arm in saved["open"]}
