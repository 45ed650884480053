"""From a schedule to its judgement and back: runs that were left by hand, so that none has to be run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
from hand_made_runs import left_in, put, quat, record, told

from deploy.batch import Done
from deploy.chaos.catalogue import Event
from deploy.chaos.shrink import shrink
from deploy.chaos.storm import Carry, short_carry
from deploy.chaos.trials import cost_text, failing_as, tried, try_all
from deploy.planned_run import Run

SCHEDULE: list[Event] = [
    {"at_s": 1.0, "kind": "kill", "agent": "a1"},
    {"at_s": 1.2, "kind": "leave", "agent": "a3"},
    {"at_s": 1.4, "kind": "kill", "agent": "a2"},
    {"at_s": 1.6, "kind": "start", "agent": "a2"},
    {"at_s": 1.8, "kind": "kill", "agent": "leader"},
]
BROKE = "exit status 3: no simulator"


def leave(run: Run, root: Path, tilt_deg: float) -> None:
    """What a run leaves whose events were all seen, and whose load tilted by so much."""
    schedule = run.changes["events"]
    tellings = [
        told(kind, round(1000 * event["at_s"]), event=event["kind"], agent=event["agent"])
        for event in schedule
        for kind in ("ordered", "seen")
    ]
    tellings += [told("lost", 2000, agent=event["agent"], why="it was killed") for event in schedule[:1]]
    folder = root / run.place
    folder.mkdir(parents=True)
    left_in(folder, record(put("load.quat_wxyz", 40, quat(tilt_deg)), tuple(tellings), scenario=run.resolved()))


def shrink_run(carry: Carry, events: Sequence[Event]) -> Run:
    return carry.run("shrink", "tilt", "", events, 1)


def test_a_schedule_is_cut_down_to_what_its_runs_say(tmp_path: Path) -> None:
    """The load tilts by 7 deg in every run in which a2 dies and the leader as well, and by 1 deg in the others."""
    carry = short_carry(4, "paper")
    for count in range(len(SCHEDULE) + 1):
        for part in combinations(SCHEDULE, count):
            kinds = {(event["kind"], event["agent"]) for event in part}
            if ("start", "a2") in kinds and ("kill", "a2") not in kinds:
                continue  # no schedule: nothing may be run for it
            guilty = {("kill", "a2"), ("kill", "leader")} <= kinds
            leave(shrink_run(carry, part), tmp_path, 7.0 if guilty else 1.0)
    lines: list[str] = []
    first = tried(shrink_run(carry, SCHEDULE), tmp_path)
    shrunk = shrink(SCHEDULE, failing_as(first, carry, 1, tmp_path, lines.append))
    assert shrunk.events == [SCHEDULE[2], SCHEDULE[4]]
    assert any("tilt violated, 7 deg" in line for line in lines)


def test_what_violates_nothing_is_no_failure_to_go_by(tmp_path: Path) -> None:
    carry = short_carry(4, "paper")
    leave(shrink_run(carry, []), tmp_path, 1.0)
    with pytest.raises(ValueError, match="violates no invariant"):
        failing_as(tried(shrink_run(carry, []), tmp_path), carry, 1, tmp_path, print)


class Engine:
    """Leaves all runs but those with a start, which break."""

    def run_all(self, runs: Sequence[Run], root: Path) -> Iterator[Done]:
        for run in runs:
            breaks = any(event["kind"] == "start" for event in run.changes["events"])
            if not breaks:
                leave(run, root, 1.0)
            yield Done(run, BROKE if breaks else "")


def test_what_could_not_be_run_is_unknown_with_the_reason(tmp_path: Path) -> None:
    carry = short_carry(4, "paper")
    good, bad = shrink_run(carry, SCHEDULE[:2]), shrink_run(carry, SCHEDULE)
    counted: list[tuple[int, int]] = []
    found: Any = try_all([good, bad, good], tmp_path, Engine(), lambda there, total: counted.append((there, total)))
    assert counted[-1] == (2, 2)
    assert found[good.place].of("events_complete").verdict == "holds"
    assert found[bad.place].outcome == found[bad.place].verdict == "unknown"
    assert BROKE in found[bad.place].findings[0].why
    assert cost_text([good, bad], tmp_path) == "No run was measured."
