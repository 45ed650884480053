"""The paper's claims as pure functions of traces: each says what was measured and whether the claim holds in it.

A trace is what :func:`sim_server.trace.read_trace` gives. Where the paper gives no number ("accuracy is maintained"),
the bound is ours and its reason stands beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_server.metrics import goal_distance_m, lowest_corner_m, roll_pitch_yaw_deg, tilt_deg

Array = NDArray[np.float64]
Trace = Mapping[str, Array]

SELECTIVE = 3.0
"""Planar over vertical displacement, root mean squares. A hand that yields alike in all directions has sqrt(2)."""
ACCURATE_M, ACCURATE_DEG = 0.010, 1.0
"""Task space "maintained": 10 mm and 1 degree, root mean squares, while the hand is pushed about by decimetres. (Peaks
are a matter of how hard it is pushed; the paper gives no forces.)"""
CLEARLY_SMALLER = 0.7
"""Error with dynamic over that with fixed stiffness."""
SETTLED = 0.01
"""Part of the final mean torque within which it has settled."""
NEAR_GOAL_M = 0.3
"""The table still arrives: within 0.3 m, an eighth of its length and its way."""
TILT_DEG: Mapping[str, float] = {
    "undisturbed": 0.5,
    "pushed": 1.0,
    "pushed-along": 1.0,
    "twisted": 1.0,
    "failed-grasp": 2.0,
}
BACK_AFTER_S, BACK_WITHIN_DEG = 1.0, 0.2
"""Quickly back to the initial pose: a second after the push the tilt is no more than this above that before it."""
STRAIGHT = 1.1
"""Smoothly: the way is at most a tenth longer than the straight one."""


@dataclass(frozen=True, slots=True)
class Found:
    """What one trace, or a pair of them, says of a claim."""

    value: float
    """The measured number, in ``unit``."""
    unit: str
    bound: str
    """What it is held against."""
    holds: bool


def at_most(value: float, unit: str, bound: float) -> Found:
    """Holds if the value is not above the bound."""
    return Found(value, unit, f"<= {bound:g}", bool(value <= bound))


def at_least(value: float, unit: str, bound: float) -> Found:
    """Holds if the value is not below the bound."""
    return Found(value, unit, f">= {bound:g}", bool(value >= bound))


# VI-A


def selectivity(hand: Array) -> Found:
    """How much more the hand moves in the plane than in height: (rows, 3) m, its places in the arm's base frame."""
    moved = hand - hand[0]
    return at_least(rms(np.hypot(moved[:, 0], moved[:, 1])) / max(rms(moved[:, 2]), 1e-9), "", SELECTIVE)


def height_kept(hand: Array) -> Found:
    """Change of the hand's height, root mean square, mm."""
    return at_most(1e3 * rms(hand[:, 2] - hand[0, 2]), "mm", 1e3 * ACCURATE_M)


def level_kept(trace: Trace) -> Found:
    """Tilt of what the hand holds, root mean square, deg."""
    return at_most(rms(tilt_deg(trace["load.quat_wxyz"])), "deg", ACCURATE_DEG)


# VI-B: dynamic against fixed stiffness


def smaller_error(fixed: Array, dynamic: Array) -> Found:
    """Height errors, (rows,) m: the ratio of their root mean squares."""
    return at_most(rms(dynamic) / rms(fixed), "of fixed", CLEARLY_SMALLER)


def smaller_torque(fixed: Trace, dynamic: Trace) -> Found:
    """Mean over time of the sum of the joints' |tau|: the ratio."""
    return at_most(float(summed_torque(dynamic).mean() / summed_torque(fixed).mean()), "of fixed", 1.0)


def faster_convergence(fixed: Trace, dynamic: Trace, period_s: float) -> Found:
    """Times until the torque has settled: the ratio."""
    return at_most(settling_time_s(dynamic, period_s) / max(settling_time_s(fixed, period_s), 1e-9), "of fixed", 1.0)


def summed_torque(trace: Trace, arm: str = "a1") -> Array:
    """Sum of the absolute joint torques of an arm, (rows,) N m."""
    total: Array = np.abs(trace[f"{arm}.tau"]).sum(axis=1)
    return total


def settling_time_s(trace: Trace, period_s: float) -> float:
    """When the torque's mean over the last period came within 1 % of its final value for good; inf if the trace is
    shorter than two periods."""
    time_s, torque = trace["time_s"], summed_torque(trace)
    rows = round(period_s / float(time_s[1] - time_s[0]))
    if len(torque) < 2 * rows:
        return float("inf")
    summed = np.concatenate([[0.0], np.cumsum(torque)])
    mean = (summed[rows:] - summed[:-rows]) / rows
    off = np.flatnonzero(np.abs(mean - mean[-1]) > SETTLED * mean[-1])
    return float(time_s[off[-1] + 1] - time_s[0]) if off.size else 0.0


# VI-C


def arrives(trace: Trace, goal_m: tuple[float, float]) -> Found:
    """Distance from the goal at the end, m."""
    return at_most(float(goal_distance_m(trace["load.position"][-1:], goal_m)[0]), "m", NEAR_GOAL_M)


def stays_level(trace: Trace, condition: str) -> Found:
    """The largest tilt, deg, against the bound of that condition."""
    return at_most(float(tilt_deg(trace["load.quat_wxyz"]).max()), "deg", TILT_DEG[condition])


def goes_straight(trace: Trace, goal_m: tuple[float, float]) -> Found:
    """Length of the way until the load is nearest to its goal, over the straight one."""
    place = trace["load.position"][:, :2]
    until = int(np.argmin(goal_distance_m(trace["load.position"], goal_m))) + 1
    way = float(np.linalg.norm(np.diff(place[:until], axis=0), axis=1).sum())
    return at_most(way / float(np.hypot(*(place[until - 1] - place[0]))), "of straight", STRAIGHT)


def tilts_little(trace: Trace, begin_s: float, end_s: float, condition: str) -> Found:
    """How far a disturbance, and the second after it, takes the tilt from what it was right before, deg."""
    time_s, tilt = trace["time_s"], tilt_deg(trace["load.quat_wxyz"])
    during = (time_s >= begin_s) & (time_s <= end_s + BACK_AFTER_S)
    return at_most(float(np.abs(tilt[during] - tilt[time_s < begin_s][-1]).max()), "deg", TILT_DEG[condition])


def comes_back(trace: Trace, begin_s: float, end_s: float) -> Found:
    """How much larger the tilt is, deg, a second after a disturbance than right before it."""
    time_s, tilt = trace["time_s"], tilt_deg(trace["load.quat_wxyz"])
    before, after = float(tilt[time_s < begin_s][-1]), float(tilt[time_s >= end_s + BACK_AFTER_S][0])
    return at_most(after - before, "deg", BACK_WITHIN_DEG)


def is_felt(lost: Trace, undisturbed: Trace) -> Found:
    """A lost bearer turns the load out of the plane and in it: the smaller of the ratios to the undisturbed carry."""

    def turned(trace: Trace) -> tuple[float, float]:
        yaw = roll_pitch_yaw_deg(trace["load.quat_wxyz"])[:, 2]
        return float(tilt_deg(trace["load.quat_wxyz"]).max()), float(np.abs(yaw - yaw[0]).max())

    (tilt, yaw), (tilt_0, yaw_0) = turned(lost), turned(undisturbed)
    return at_least(min(tilt / tilt_0, yaw / yaw_0), "of undisturbed", 2.0)


def needs_a_team(alone: Trace, footprint_m: tuple[float, float]) -> Found:
    """Height of the lowest corner of the load's footprint, m, when it is lowest: one arm cannot keep it off the floor.

    Args:
        footprint_m: length along x and width along y of the load; its frame O is in the middle, on the lowest level.
    """
    lowest = lowest_corner_m(alone["load.position"], alone["load.quat_wxyz"], footprint_m)
    return at_most(float(lowest.min()), "m", 0.0)


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
