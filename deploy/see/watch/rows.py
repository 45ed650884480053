"""What one row says, read without the scenario: how many joints an arm has follows from the row's length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim_server.errors import SimError
from sim_server.metrics import roll_pitch_yaw_deg, tilt_deg
from sim_server.trace_columns import columns
from wire.messages import Row

Array = NDArray[np.float64]

NUMBER = 8
"""Bytes of a number."""
WAY_WIDTH = 7
"""Numbers that a row begins with: the load's position and its orientation, w first."""


class UnreadableRow(SimError):
    """A row whose length fits no number of joints."""


@dataclass(frozen=True, slots=True)
class Load:
    """How the load stands."""

    p_WO: tuple[float, float, float]
    """Of its frame O in the world, m."""
    tilt_deg: float
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    pull_N: float
    """How hard the leader pulls."""


@dataclass(frozen=True, slots=True)
class Arm:
    """What a row says of one arm; NaN where there is nothing."""

    x_m: float
    """Of its base, in the world."""
    y_m: float
    yaw_rad: float
    age_ticks: float
    """Of the command that it obeys, from the state that this answers; 0 in lock-step."""
    stiffness_Nm_rad: float
    """Mean over its joints."""
    up_N: float
    """Upward force of its hand on the load."""


def read_row(row: Row) -> tuple[Load, dict[str, Arm]]:
    """The load, and every arm that is there, by name.

    Raises:
        UnreadableRow: the row does not have the numbers that its arms need.
    """
    values = _named(row)
    quat = values["load.quat_wxyz"][None]
    x, y, z = values["load.position"].tolist()
    roll, pitch, yaw = roll_pitch_yaw_deg(quat)[0].tolist()
    pull = float(np.linalg.norm(values["leader.force"]))
    load = Load((x, y, z), float(tilt_deg(quat)[0]), roll, pitch, yaw, pull)
    return load, {name: _arm(values, name) for name in row.arms.split()}


def _arm(values: dict[str, Array], name: str) -> Arm:
    x, y, yaw = values[f"{name}.base"].tolist()
    return Arm(
        x_m=x,
        y_m=y,
        yaw_rad=yaw,
        age_ticks=float(values[f"{name}.age_ticks"][0]),
        stiffness_Nm_rad=float(values[f"{name}.stiffness"].mean()),
        up_N=float(values[f"{name}.grip"][2]),
    )


def _named(row: Row) -> dict[str, Array]:
    """The values of every column, (width,) each; tick and time are not among them."""
    arms = row.arms.split()
    named = columns(arms, joints_of(row))
    flat = np.frombuffer(row.values, "<f8")
    found: dict[str, Array] = {}
    start = 0
    for name, width in named.items():
        if name not in ("tick", "time_s"):
            found[name] = flat[start : start + width]
            start += width
    return found


def joints_of(row: Row) -> int:
    """How many joints every arm of this row has; 1 if there is no arm.

    Raises:
        UnreadableRow: no whole number of them.
    """
    arms = len(row.arms.split())
    joints = _joints(arms, len(row.values))
    if joints is None:
        raise UnreadableRow(
            f"row of tick {row.tick}: got {len(row.values)} bytes of {arms} arms, expected a whole number of joints: "
            "install the same release as the simulator's"
        )
    return joints


@lru_cache
def _joints(arms: int, size_bytes: int) -> int | None:
    names = [str(k) for k in range(arms)]
    least, more = (NUMBER * (sum(columns(names, joints).values()) - 2) for joints in (1, 2))
    if not arms:
        return 1 if size_bytes == least else None
    extra, rest = divmod(size_bytes - least, more - least)
    return None if extra < 0 or rest else 1 + extra


def is_readable(row: Row) -> bool:
    """Whether its length fits its arms."""
    return _joints(len(row.arms.split()), len(row.values)) is not None


def read_ways(rows: Sequence[Row]) -> tuple[Array, Array]:
    """Where the load was in readable rows, (rows, 3) m in the world, and its tilt, (rows,) deg. That is all that is
    looked at in every row."""
    together = b"".join(row.values[: NUMBER * WAY_WIDTH] for row in rows)
    values = np.frombuffer(together, "<f8").reshape(len(rows), WAY_WIDTH)
    return values[:, :3], tilt_deg(values[:, 3:])


def share_percent(arms: dict[str, Arm]) -> dict[str, float]:
    """Part of what all hands bear together that each one bears; NaN where nobody bears anything."""
    together = math.fsum(arm.up_N for arm in arms.values() if math.isfinite(arm.up_N))
    if together <= 0:
        return dict.fromkeys(arms, math.nan)
    return {name: 100.0 * arm.up_N / together for name, arm in arms.items()}
