"""What became of the load in a run, and the run's verdict by all invariants together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from deploy.chaos.invariants import Bounds, Finding, check_all, end_speed_mm_s, goal_error, lowest_corner
from deploy.chaos.record import Record, read_record
from sim_server.metrics import tilt_deg
from sim_server.run_folder import RunFolderError, write_json
from sim_server.verdict import Verdict

Outcome = Literal["carries", "stops", "moves", "drops", "unknown"]

OUTCOMES: Mapping[Outcome, str] = {
    "carries": "at the goal in the end, and all invariants of the carry hold",
    "stops": "stands still in the end, and never sank or tilted too far",
    "moves": "never sank or tilted too far, but is neither at the goal nor standing still in the end",
    "drops": "sank or tilted too far",
    "unknown": "a fault was not seen to take effect, or the run did not reach its end",
}
"""What can become of the load. A load at its goal that breaks another invariant of the carry, such as the grip force,
counts by whether it stands still."""

OF_THE_CARRY = ("height", "tilt", "grip_force", "torque_limits", "others_carry", "arrives_or_stops")
"""The invariants that are about the load and those who carry it; the others are about the run."""

JUDGEMENT = "chaos.json"


@dataclass(frozen=True)
class Judgement:
    """A run, judged."""

    outcome: Outcome
    verdict: Verdict
    findings: tuple[Finding, ...]
    tilt_max_deg: float | None = None
    height_min_m: float | None = None
    """Of its lowest corner above the floor."""
    goal_error_m: float | None = None
    """Largest in the last second."""

    def of(self, invariant: str) -> Finding:
        """What an invariant says. Raises KeyError if there is none of that name."""
        return {finding.invariant: finding for finding in self.findings}[invariant]

    @property
    def violated(self) -> tuple[Finding, ...]:
        """The invariants that are."""
        return tuple(finding for finding in self.findings if finding.verdict == "violated")


def judge(record: Record, bounds: Bounds | None = None) -> Judgement:
    """Hold all invariants against a run."""
    findings = check_all(record, bounds)
    return Judgement(
        outcome_of(findings, record, (bounds or Bounds()).of(record.run["scenario"])),
        verdict_of(findings),
        findings,
        float(tilt_deg(record.trace["load.quat_wxyz"]).max()),
        float(lowest_corner(record).min()),
        goal_error(record),
    )


def verdict_of(findings: Sequence[Finding]) -> Verdict:
    """Violated if any invariant is, else unknown if any is, else they hold."""
    verdicts = {finding.verdict for finding in findings}
    return "violated" if "violated" in verdicts else "unknown" if "unknown" in verdicts else "holds"


def outcome_of(findings: Sequence[Finding], record: Record, bounds: Bounds) -> Outcome:
    """What became of the load."""
    by_name = {finding.invariant: finding.verdict for finding in findings}
    if by_name["events_complete"] != "holds":
        return "unknown"
    if "violated" in (by_name["height"], by_name["tilt"]):
        return "drops"
    error = goal_error(record)
    arrived = error is not None and error <= bounds.goal_error_m
    if arrived and all(by_name[name] == "holds" for name in OF_THE_CARRY):
        return "carries"
    return "stops" if end_speed_mm_s(record) <= bounds.still_mm_s else "moves"


def judge_folder(folder: Path, bounds: Bounds | None = None) -> Judgement:
    """Judge a run folder, and leave the judgement in it.

    A folder that cannot be judged is unknown, with the reason; nothing is written into it.
    """
    try:
        judgement = judge(read_record(folder), bounds)
    except RunFolderError as error:
        return Judgement("unknown", "unknown", (Finding("events_complete", "unknown", str(error)),))
    write_json(folder / JUDGEMENT, describe(judgement))
    return judgement


def describe(judgement: Judgement) -> dict[str, Any]:
    """The content of chaos.json."""
    return asdict(judgement)


def outcome_counts(judgements: Sequence[Judgement]) -> dict[Outcome, int]:
    """How many of each outcome; all of them are named."""
    return {name: sum(judgement.outcome == name for judgement in judgements) for name in OUTCOMES}


def verdict_counts(judgements: Sequence[Judgement]) -> dict[Verdict, int]:
    """How many of each verdict; all of them are named."""
    return {name: sum(judgement.verdict == name for judgement in judgements) for name in get_args(Verdict)}
