"""The mobile bases of a world: where they are, how they move, and how their drives push them.

A base that is fixed has no joints in the model: it is a part of the floor, so it does not move by a bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_server.layout import Array
from sim_server.world import ArmIds


def base_place(ids: ArmIds, data: Any) -> Array:
    """x, y [m], yaw [rad] of one robot's base in the world, (3,), the caller's own."""
    place: Array = data.qpos[ids.base_qpos] if ids.fixed_at is None else ids.fixed_at
    return place.copy()


def base_rate(ids: ArmIds, data: Any) -> Array:
    """Rates of the same, (3,), the caller's own."""
    rate: Array = data.qvel[ids.base_dof] if ids.fixed_at is None else np.zeros(3)
    return rate.copy()


class Bases:
    """The bases of N robots; all of a world are fixed, or none."""

    def __init__(self, arms: Sequence[ArmIds]) -> None:
        fixed = [ids.fixed_at for ids in arms if ids.fixed_at is not None]
        self._fixed = np.array(fixed) if fixed else None
        self._still = np.zeros((len(arms), 3))
        self._qpos = _indices([ids.base_qpos for ids in arms])
        self._dofs = _indices([ids.base_dof for ids in arms])
        self._yaws, self._flat_dofs = self._qpos[:, 2:].ravel(), self._dofs.ravel()

    def places(self, qpos: Array) -> Array:
        """x, y, yaw of all, (N, 3) m, rad, world."""
        return self._fixed if self._fixed is not None else qpos[self._qpos]

    def rates(self, qvel: Array) -> Array:
        """Their rates, (N, 3)."""
        return self._still if self._fixed is not None else qvel[self._dofs]

    def drive(self, applied: Array, qpos: Array, forces: Array) -> None:
        """Write the drives' forces, (N, 3) N, N, N m, each in its base frame B, into MuJoCo's applied forces."""
        if self._fixed is not None:
            return
        written: list[float] = []  # in plain numbers: for a handful of bases numpy takes twice as long
        for yaw, (x, y, turn) in zip(qpos[self._yaws].tolist(), forces.tolist(), strict=True):
            c, s = math.cos(yaw), math.sin(yaw)
            written += (c * x - s * y, s * x + c * y, turn)
        applied[self._flat_dofs] = written


def _indices(slices: Sequence[slice]) -> NDArray[np.intp]:
    return np.array([range(each.start, each.stop) for each in slices], dtype=np.intp)
