"""What must hold in a run whatever happens to it: pure functions of what it left.

Each holds, is violated (at a tick, by how much), or is unknown (why). A run that did not reach its end can violate an
invariant, but none holds in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.chaos.record import Array, Record
from deploy.chaos.sights import unseen_faults
from sim_server.metrics import goal_distance_m, lowest_corner_m, tilt_deg
from sim_server.verdict import Verdict

LAST_S = 1.0
"""End of a run over which the load has to have arrived, or to stand still."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """How far a load may go."""

    sink_max_m: float = 0.08
    """Of its lowest corner, below its height at the start. The shipped loads start 0.10 m above the floor: one that
    holds this has never been nearer to it than 2 cm."""
    tilt_max_deg: float = 5.0
    """Ten times what an undisturbed carry may tilt (0.5 deg in `transport`); a full glass stays full."""
    grip_max_N: float = 300.0
    """Of one hand on the load, where a fair share of the shipped loads is 50 to 75 N."""
    goal_error_m: float = 0.10
    """Distance from the goal at which the load has arrived, unless the scenario's `[expect]` has another."""
    still_mm_s: float = 10.0
    """A load that is slower than this, along and upwards, stands still: 0.6 m in a minute at most."""

    def of(self, scenario: Mapping[str, Any]) -> Bounds:
        """These, with the scenario's own bound of the distance from the goal."""
        bound = scenario["expect"].get("goal_error_m") or {}
        return self if bound.get("max") is None else replace(self, goal_error_m=float(bound["max"]))


@dataclass(frozen=True, slots=True)
class Finding:
    """What an invariant says of a run."""

    invariant: str
    verdict: Verdict
    why: str
    tick: int | None = None
    """Violated: the first tick at which it is, where there is one."""
    time_s: float | None = None
    by: float | None = None
    """Violated: by how much at most, in the unit."""
    unit: str = ""

    @property
    def text(self) -> str:
        """In one line: the reason, and when and by how much."""
        when = "" if self.tick is None else f", first at tick {self.tick} ({self.time_s:g} s)"
        much = "" if self.by is None else f", by {self.by:.3g} {self.unit}"
        return f"{self.why}{when}{much}"


def height(record: Record, bounds: Bounds) -> Finding:
    """The load's lowest corner never sinks further than it may."""
    corner = lowest_corner(record)
    return _bounded("height", record, corner[0] - corner, bounds.sink_max_m, "m", "below its start")


def tilt(record: Record, bounds: Bounds) -> Finding:
    """The load's vertical stays near the world's."""
    angle = tilt_deg(record.trace["load.quat_wxyz"])
    return _bounded("tilt", record, angle, bounds.tilt_max_deg, "deg", "off the vertical")


def grip_force(record: Record, bounds: Bounds) -> Finding:
    """No hand presses or pulls harder than it may."""
    forces = [np.linalg.norm(record.trace[f"{arm}.grip"][:, :3], axis=1) for arm in _arms(record)]
    worst = np.max(np.nan_to_num(forces), axis=0)  # a robot that is not there has no numbers, and does not press
    return _bounded("grip_force", record, worst, bounds.grip_max_N, "N", "of one hand")


def torque_limits(record: Record, bounds: Bounds) -> Finding:
    """No joint got more torque than it may give."""
    limits = np.array(record.run["facts"]["torque_max_Nm"])
    over = [np.abs(record.trace[f"{arm}.tau"]) - limits for arm in _arms(record)]
    worst = np.max(np.nan_to_num(over, nan=-np.inf), axis=(0, 2))
    rounding = 1e-9  # the driver clips to the very limit; this is for other recorders' arithmetic
    found = _bounded("torque_limits", record, worst, rounding, "N m", "beyond a joint's limit")
    if found.verdict == "holds":
        return replace(found, why=f"every joint at least {max(0.0, -float(worst.max())):.3g} N m below its limit")
    return found


def others_carry(record: Record, bounds: Bounds) -> Finding:
    """An arm that no event is about stays in, and holds the load from the first row to the last."""
    name, tick, time_s = "others_carry", record.trace["tick"], record.trace["time_s"]
    others = [arm for arm in _arms(record) if arm not in record.struck and np.isfinite(_grip(record, arm)[0]).all()]
    for event in record.events:
        if event["kind"] in ("lost", "left") and event.get("agent") in others:
            why = f"{event['agent']} was {event['kind']}, though nothing was done to it"
            return Finding(name, "violated", why, int(event["tick"]), float(event["time_s"]), 1.0, "arm")
    for arm in others:
        free = ~np.nan_to_num(_grip(record, arm)).any(axis=1)
        if free.any():
            first = int(np.argmax(free))
            away_s = float(np.mean(free) * (time_s[-1] - time_s[0]))
            why = f"{arm} let go, though nothing was done to it"
            return Finding(name, "violated", why, int(tick[first]), float(time_s[first]), away_s, "s")
    if not others:
        return _ended(record, Finding(name, "holds", "something was done to every arm"))
    return _ended(record, Finding(name, "holds", f"{', '.join(others)} held the load all the time"))


def arrives_or_stops(record: Record, bounds: Bounds) -> Finding:
    """In the end the load is at its goal, or it stands still."""
    name = "arrives_or_stops"
    error, fastest = goal_error(record), end_speed_mm_s(record)
    if not record.completed:
        return _ended(record, Finding(name, "holds", ""))
    if error is not None and error <= bounds.goal_error_m:
        return Finding(name, "holds", f"arrived: {error:.3f} m from the goal in the last second")
    if fastest <= bounds.still_mm_s:
        where = "" if error is None else f" {error:.2f} m from the goal"
        return Finding(name, "holds", f"stopped{where}: {fastest:.1f} mm/s")
    why = f"neither at the goal nor standing still: {fastest:.1f} mm/s in the last second"
    end = record.trace["tick"][-1], record.trace["time_s"][-1]
    return Finding(name, "violated", why, int(end[0]), float(end[1]), fastest - bounds.still_mm_s, "mm/s")


def silence(record: Record, bounds: Bounds) -> Finding:
    """Nobody heard what is not theirs: the run's own audit."""
    if record.audit is None:
        return Finding("silence", "unknown", "the run was not audited")
    verdict: Verdict = record.audit["verdict"]
    return Finding("silence", verdict, "; ".join(record.audit["why"]) or "no key reached two agents")


def events_complete(record: Record, bounds: Bounds) -> Finding:
    """Every fault was ordered and seen to take effect, and the events tell the run from its start to its end, in order.

    A fault that was not seen makes it unknown: what the run would have done under it is not known. What the
    simulator itself calls unproven counts, since not all that is seen proves something (a loss that hit no message);
    only where it says nothing of that, what its events tell.
    """
    name = "events_complete"
    ticks = [int(event["tick"]) for event in record.events]
    for before, after, event in zip(ticks, ticks[1:], record.events[1:], strict=False):
        if after < before:
            why = f"{event['kind']!r} is told after what came later"
            return Finding(name, "violated", why, after, float(event["time_s"]), float(before - after), "ticks")
    kinds = [event["kind"] for event in record.events]
    missing = [kind for kind in ("started", "ended") if kind not in kinds]
    if missing:
        return Finding(name, "unknown", f"no event {' or '.join(map(repr, missing))}: the events are cut off")
    told = record.run.get("unproven")
    if unproven := unseen_faults(record.schedule, record.events) if told is None else told:
        return Finding(name, "unknown", f"not seen to take effect: {'; '.join(unproven)}")
    if not record.completed:
        return Finding(name, "unknown", f"the run did not reach its end: {record.run['ended']['why']}")
    return Finding(name, "holds", f"all {len(record.schedule)} scheduled events were seen to take effect")


def nobody_left(record: Record, bounds: Bounds) -> Finding:
    """No process of the run was there after its end."""
    if record.left_over is None:
        return Finding("nobody_left", "unknown", "nobody looked for its processes right after its end")
    if record.left_over:
        why = f"still there after the end: {'; '.join(record.left_over)}"
        return Finding("nobody_left", "violated", why, by=float(len(record.left_over)), unit="processes")
    return Finding("nobody_left", "holds", "none of its processes is left")


INVARIANTS: tuple[Callable[[Record, Bounds], Finding], ...] = (
    height,
    tilt,
    grip_force,
    torque_limits,
    others_carry,
    arrives_or_stops,
    silence,
    events_complete,
    nobody_left,
)
"""All of them, in the order of the report."""


def check_all(record: Record, bounds: Bounds | None = None) -> tuple[Finding, ...]:
    """What every invariant says, with the scenario's own bound of the goal."""
    own = (bounds or Bounds()).of(record.run["scenario"])
    return tuple(invariant(record, own) for invariant in INVARIANTS)


def lowest_corner(record: Record) -> Array:
    """Height of the load's lowest corner above the floor, (rows,) m."""
    footprint_m = record.run["scenario"]["load"]["size_m"][:2]
    return lowest_corner_m(record.trace["load.position"], record.trace["load.quat_wxyz"], footprint_m)


def goal_error(record: Record) -> float | None:
    """Largest distance of the load from its goal in the last second, m; None without a goal."""
    goal = record.run["facts"]["goal_m"]
    if goal is None:
        return None
    return float(goal_distance_m(record.trace["load.position"][_last(record)], goal).max())


def end_speed_mm_s(record: Record) -> float:
    """Largest speed of the load in the last second, in the plane or up and down."""
    speed = record.trace["load.linear_velocity"][_last(record)]
    return 1e3 * float(max(np.hypot(speed[:, 0], speed[:, 1]).max(), np.abs(speed[:, 2]).max()))


def _last(record: Record) -> NDArray[np.bool_]:
    """Which rows are of the last second, (rows,)."""
    time_s = record.trace["time_s"]
    return np.asarray(time_s >= time_s[-1] - LAST_S)


def _arms(record: Record) -> list[str]:
    return list(record.run["facts"]["arms"])


def _grip(record: Record, arm: str) -> Array:
    return record.trace[f"{arm}.grip"]


def _bounded(name: str, record: Record, value: Array, most: float, unit: str, what: str) -> Finding:
    """Whether a value, (rows,), stays at or below its bound."""
    worst = float(value.max())
    over = value > most
    if not over.any():
        return _ended(record, Finding(name, "holds", f"at most {worst:.3g} {unit} {what}, of {most:g} {unit}"))
    first = int(np.argmax(over))
    tick, time_s = int(record.trace["tick"][first]), float(record.trace["time_s"][first])
    why = f"{worst:.3g} {unit} {what}, where {most:g} {unit} are allowed"
    return Finding(name, "violated", why, tick, time_s, worst - most, unit)


def _ended(record: Record, finding: Finding) -> Finding:
    """The finding, if the run reached its end; else nothing is known of the rest."""
    if record.completed:
        return finding
    return Finding(finding.invariant, "unknown", f"the run did not reach its end: {record.run['ended']['why']}")
