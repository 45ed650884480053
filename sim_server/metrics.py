"""The numbers of a run, computed from its trace alone. SI, and degrees where the name says so; docs/metrics.md.

What only the running system can know (wall times, refusals) is kept in run.json and passed through.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

GRAVITY_M_S2 = 9.81
ARRIVED_WITHIN_M = 0.10
"""A load has arrived when it stays this close to the goal until the end."""
STANDSTILL_WINDOW_S = 1.0
"""End of the run over which the remaining speed is taken."""

Metrics = dict[str, float | dict[str, float] | None]

METRICS: Mapping[str, str] = {
    "duration_s": "simulated time from the first recorded tick to the last",
    "path_length_m": "way of the load in the plane",
    "end_speed_mm_s": "largest planar speed of the load in the last second",
    "goal_error_m": "planar distance of the load from the goal at the end",
    "arrival_time_s": "when the load came within 0.10 m of the goal for good",
    "overshoot_m": "how far the load went past the goal along the straight way to it",
    "drift_mm_per_min": "how fast the load wandered with nobody leading",
    "tilt_max_deg": "largest angle between the load's vertical and the world's",
    "tilt_rms_deg": "the same, root mean square",
    "sag_max_mm": "largest change of the load's height from its start",
    "sag_rms_mm": "the same, root mean square",
    "yaw_max_deg": "largest turn of the load about the vertical from its start",
    "internal_force_rms_N": "the part of a hand's force that moves nothing, root mean square over hands and time",
    "grip_force_max_N": "largest force of one hand on the load",
    "leader_force_max_N": "largest pull of the leader",
    "leader_impulse_Ns": "the leader's pull over time",
    "torque_rms_Nm": "joint torque, root mean square over all joints and time",
    "torque_limit_fraction": "largest joint torque as a part of its limit",
    "energy_J": "work that motors and bases did or took up",
    "real_time_factor": "simulated time over wall time",
    "wall_s": "wall time of the run",
    "missed_percent": "part of the arms' ticks in which no new command came",
    "missed_in_row_max": "most ticks in a row that one arm missed",
    "age_max_ticks": "oldest command that an arm obeyed, in ticks from the state it answers; real time only",
    "slowed_s": "wall time that simulated time fell behind for good; real time only",
    "refused_messages": "messages that did not fit and were refused",
}
"""Every metric that is one number, by its name in metrics.json and in a scenario's ``[expect]``, and its meaning."""


@dataclass(frozen=True, slots=True)
class TraceFacts:
    """What the metrics need besides the trace."""

    arms: tuple[str, ...]
    goal_m: tuple[float, float] | None
    load_mass_kg: float
    centre_of_mass_m: tuple[float, float, float]
    """In the load's frame O."""
    grasps_m: Mapping[str, Sequence[float]]
    """Grasp point of every arm, in O."""
    torque_max_Nm: tuple[float, ...]


def trace_facts(facts: Mapping[str, Any]) -> TraceFacts:
    """The facts of a run.json. Raises :class:`LookupError` or :class:`TypeError` for what is none."""
    return TraceFacts(
        arms=tuple(facts["arms"]),
        goal_m=facts["goal_m"] and tuple(facts["goal_m"]),
        load_mass_kg=facts["load_mass_kg"],
        centre_of_mass_m=tuple(facts["centre_of_mass_m"]),
        grasps_m=facts["grasps_m"],
        torque_max_Nm=tuple(facts["torque_max_Nm"]),
    )


def physical_metrics(trace: Mapping[str, Array], facts: TraceFacts) -> Metrics:
    """All metrics that the trace holds. A metric that does not apply (no goal, no leader) is None.

    Raises:
        ValueError: the trace has no rows.
    """
    time_s = trace["time_s"]
    if time_s.size == 0:
        raise ValueError("the trace has no rows: the run ended before its first tick")
    position, quat = trace["load.position"], trace["load.quat_wxyz"]
    return {
        "duration_s": float(time_s[-1] - time_s[0]),
        **_path(time_s, position, trace["load.linear_velocity"], facts.goal_m),
        **_attitude(position, quat),
        **_forces(trace, facts),
        **_effort(trace, facts),
    }


def tilt_deg(quat_wxyz: Array) -> Array:
    """Angle between the load's vertical and the world's, (rows,) deg, from unit quaternions (rows, 4)."""
    _, x, y, _ = quat_wxyz.T
    tilt: Array = np.degrees(2.0 * np.arcsin(np.minimum(1.0, np.hypot(x, y))))
    return tilt


def roll_pitch_yaw_deg(quat_wxyz: Array) -> Array:
    """Roll, pitch, yaw (x, y, z; yaw unwrapped) of unit quaternions (rows, 4), as (rows, 3) deg."""
    w, x, y, z = quat_wxyz.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    angles: Array = np.degrees(np.stack([roll, pitch, yaw], axis=1))
    return angles


def rotation_matrices(quat_wxyz: Array) -> Array:
    """Rotation matrices R_WO, (rows, 3, 3), of unit quaternions (rows, 4)."""
    w, x, y, z = quat_wxyz.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )


def lowest_corner_m(position: Array, quat_wxyz: Array, footprint_m: Sequence[float]) -> Array:
    """Height of the lowest corner of a load's footprint, (rows,) m.

    Args:
        position: of the frame O, in the middle of the footprint and on its level, (rows, 3).
        quat_wxyz: of O, unit quaternions (rows, 4).
        footprint_m: length along x and width along y of O.
    """
    R_WO = rotation_matrices(quat_wxyz)
    lean = 0.5 * (np.abs(R_WO[:, 2, 0]) * footprint_m[0] + np.abs(R_WO[:, 2, 1]) * footprint_m[1])
    height: Array = position[:, 2] - lean
    return height


def goal_distance_m(position: Array, goal_m: Sequence[float]) -> Array:
    """Planar distance of the load's frame O from the goal, (rows,) m."""
    return np.hypot(position[:, 0] - goal_m[0], position[:, 1] - goal_m[1])


def internal_forces(grips: Array, arms_W: Array) -> Array:
    """The part of the grip wrenches that moves nothing, (rows, N, 6) N and N m.

    What is left of the wrenches h after taking away the smallest set G^+ G h with the same effect on the load, where G
    is the grasp matrix and "smallest" counts moments over the grasps' mean distance, so that N and N m can be added.
    This is the usual pseudo-inverse split; for one arm it is zero by definition.

    Args:
        grips: wrench of each hand on the load at its grasp [f; t], (rows, N, 6), world.
        arms_W: grasp points from the load's centre of mass, (rows, N, 3) m, world axes.
    """
    rows, count, _ = grips.shape
    length = float(np.mean(np.linalg.norm(arms_W, axis=2))) or 1.0
    G = np.zeros((rows, 6, count, 6))
    for axis in range(3):
        G[:, axis, :, axis] = 1.0
        G[:, 3 + axis, :, 3 + axis] = 1.0
    rx, ry, rz = np.moveaxis(arms_W, 2, 0)
    for row, column, value in ((3, 1, -rz), (3, 2, ry), (4, 0, rz), (4, 2, -rx), (5, 0, -ry), (5, 1, rx)):
        G[:, row, :, column] = value
    scale = np.array([1.0, 1.0, 1.0, length, length, length])
    weighted = (G * scale).reshape(rows, 6, 6 * count)
    h = (grips / scale).reshape(rows, 6 * count, 1)
    across = np.swapaxes(weighted, 1, 2)
    moving = across @ np.linalg.solve(weighted @ across, weighted @ h)
    internal: Array = (h - moving).reshape(rows, count, 6) * scale
    return internal


def _internal_of_those_who_hold(grips: Array, holds: Array, arms_W: Array) -> Array:
    """:func:`internal_forces` of the hands that hold at each instant, (rows, N); zeros for the others."""
    internal = np.zeros_like(grips)
    for who in np.unique(holds, axis=0):
        if who.any():
            rows = np.ix_(np.flatnonzero((holds == who).all(axis=1)), np.flatnonzero(who))
            internal[rows] = internal_forces(grips[rows], arms_W[rows])
    return internal


def hand_forces(trace: Mapping[str, Array], facts: TraceFacts) -> tuple[Array, Array, Array]:
    """What the hands exert on the load: the wrenches [f; t], (rows, N, 6), zero for who does not hold; whether the
    robot was there, (rows, N); and the part of the wrenches that moves nothing, (rows, N, 6)."""
    R_WO = rotation_matrices(trace["load.quat_wxyz"])
    arms_O = np.array([facts.grasps_m[arm] for arm in facts.arms]) - np.array(facts.centre_of_mass_m)
    grips = np.stack([trace[f"{arm}.grip"] for arm in facts.arms], axis=1)
    here = np.isfinite(grips).all(axis=2)
    grips = np.where(here[:, :, None], grips, 0.0)
    holds = (grips != 0.0).any(axis=2)
    return grips, here, _internal_of_those_who_hold(grips, holds, np.einsum("tij,nj->tni", R_WO, arms_O))


def _path(time_s: Array, position: Array, velocity: Array, goal_m: Sequence[float] | None) -> Metrics:
    steps = np.diff(position[:, :2], axis=0)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    found: Metrics = {
        "path_length_m": float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        "end_speed_mm_s": 1e3 * float(speed[time_s >= time_s[-1] - STANDSTILL_WINDOW_S].max()),
        "goal_error_m": None,
        "arrival_time_s": None,
        "overshoot_m": None,
        "drift_mm_per_min": None,
    }
    moved = position[-1, :2] - position[0, :2]
    if goal_m is None:
        minutes = (time_s[-1] - time_s[0]) / 60
        found["drift_mm_per_min"] = 1e3 * float(np.hypot(*moved)) / minutes if minutes > 0 else None
        return found
    distance = goal_distance_m(position, goal_m)
    found["goal_error_m"] = float(distance[-1])
    away = np.flatnonzero(distance > ARRIVED_WITHIN_M)
    if away.size == 0:
        found["arrival_time_s"] = float(time_s[0])
    elif away[-1] + 1 < time_s.size:
        found["arrival_time_s"] = float(time_s[away[-1] + 1])
    way = np.array(goal_m) - position[0, :2]
    length = float(np.hypot(*way))
    if length > 0:
        found["overshoot_m"] = max(0.0, float(((position[:, :2] - goal_m) @ way).max()) / length)
    return found


def _attitude(position: Array, quat: Array) -> Metrics:
    tilt = tilt_deg(quat)
    sag = 1e3 * np.abs(position[:, 2] - position[0, 2])
    yaw = roll_pitch_yaw_deg(quat)[:, 2]
    return {
        "tilt_max_deg": float(tilt.max()),
        "tilt_rms_deg": _rms(tilt),
        "sag_max_mm": float(sag.max()),
        "sag_rms_mm": _rms(sag),
        "yaw_max_deg": float(np.abs(yaw - yaw[0]).max()),
    }


def _forces(trace: Mapping[str, Array], facts: TraceFacts) -> Metrics:
    grips, here, internal = hand_forces(trace, facts)
    holds = (grips != 0.0).any(axis=2)
    weight = facts.load_mass_kg * GRAVITY_M_S2
    pull = np.linalg.norm(trace["leader.force"], axis=1)
    led = facts.goal_m is not None
    return {
        "internal_force_rms_N": float(np.sqrt(np.sum(internal[:, :, :3] ** 2) / max(1, np.count_nonzero(holds)))),
        "grip_force_max_N": float(np.linalg.norm(grips[:, :, :3], axis=2).max()),
        "load_share": {
            arm: float(grips[here[:, k], k, 2].mean()) / weight
            for k, arm in enumerate(facts.arms)
            if here[:, k].any()  # one that came after the last row has none
        },
        "leader_force_max_N": float(pull.max()) if led else None,
        "leader_impulse_Ns": float(np.trapezoid(pull, trace["time_s"])) if led else None,
    }


def _effort(trace: Mapping[str, Array], facts: TraceFacts) -> Metrics:
    time_s = trace["time_s"]
    tau = np.stack([trace[f"{arm}.tau"] for arm in facts.arms], axis=1)  # NaN while a robot is not there
    qd = np.stack([trace[f"{arm}.qd"] for arm in facts.arms], axis=1)
    power = np.nansum(np.abs(tau * qd), axis=(1, 2))
    for arm in facts.arms:
        yaw = trace[f"{arm}.base"][:, 2]
        force, velocity = trace[f"{arm}.base_force"], trace[f"{arm}.base_velocity"]
        along = force[:, 0] * np.cos(yaw) - force[:, 1] * np.sin(yaw)
        across = force[:, 0] * np.sin(yaw) + force[:, 1] * np.cos(yaw)
        driven = np.abs(along * velocity[:, 0] + across * velocity[:, 1] + force[:, 2] * velocity[:, 2])
        power = power + np.nan_to_num(driven)
    there = tau[np.isfinite(tau)]
    return {
        "torque_rms_Nm": _rms(there),
        "torque_limit_fraction": float(np.nanmax(np.abs(tau) / np.array(facts.torque_max_Nm))),
        "energy_J": float(np.trapezoid(power, time_s)),
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
