"""The invariants on traces made by hand, each spoiled in one place whose tick and size are known."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_made_runs import good_trace, left_in, put, quat, record, told
from hypothesis import given
from hypothesis import strategies as st

from deploy.batch import COST
from deploy.chaos.invariants import INVARIANTS, Bounds, Finding, check_all
from deploy.chaos.outcome import JUDGEMENT, Judgement, judge, judge_folder, verdict_of
from deploy.chaos.record import Record, read_record
from deploy.chaos.sights import unseen_faults
from sim_server.run_folder import TRACE, RunFolderError

KILL = {"at_s": 1.0, "kind": "kill", "agent": "a1"}


def says(invariant: str, of: Record) -> Finding:
    (found,) = [finding for finding in check_all(of) if finding.invariant == invariant]
    return found


def test_a_good_run_carries_and_holds_in_everything() -> None:
    judgement = judge(record())
    assert {finding.invariant: finding.verdict for finding in judgement.findings} == {
        invariant.__name__: "holds" for invariant in INVARIANTS
    }
    assert (judgement.outcome, judgement.verdict) == ("carries", "holds")
    assert judgement.height_min_m == 0.1
    assert judgement.tilt_max_deg == 0.0


SPOILED: Mapping[str, tuple[str, Record, int | None, float, str]] = {
    # by hand: what is violated, the first tick, by how much
    "sinks 95 mm, 80 allowed": (
        "height", record(put("load.position", slice(100, 120), [0.5, 0.0, 0.005])), 500, 0.015, "m"),
    "leans by 4 deg along its length of 1.6 m, with 40 mm to go": (
        "height",
        record(lambda trace: (
            put("load.position", 100, [0.5, 0.0, 0.06])(trace),
            put("load.quat_wxyz", 100, [np.cos(np.radians(2.0)), 0.0, np.sin(np.radians(2.0)), 0.0])(trace))),
        500, 0.8 * np.sin(np.radians(4.0)) - 0.04, "m"),
    "tilts 7.5 deg, 5 allowed": ("tilt", record(put("load.quat_wxyz", 40, quat(-7.5))), 200, 2.5, "deg"),
    "a hand pulls down with 500 N, 300 allowed": (
        "grip_force", record(put("a2.grip", 7, [300.0, 0.0, -400.0, 0, 0, 0])), 35, 200.0, "N"),
    "a second joint gives -9.5 of 8 N m": (
        "torque_limits", record(put("a3.tau", 300, [10.0, -9.5])), 1500, 1.5, "N m"),
    "a hand that nothing was done to lets go for the last second": (
        "others_carry", record(put("a2.grip", slice(401, None), 0.0)), 2005, 3.0 * 200 / 601, "s"),
    "an arm is lost that nothing was done to": (
        "others_carry", record(events=(told("lost", 1200, agent="a2"),), schedule=(KILL,)), 1200, 1.0, "arm"),
    "moves on with 60 mm/s, short of the goal": (
        "arrives_or_stops",
        record(lambda trace: (
            put("load.position", slice(None), [0.3, 0.0, 0.1])(trace),
            put("load.linear_velocity", slice(500, None), [0.06, 0.0, 0.0])(trace))),
        3000, 50.0, "mm/s"),
    "sinks on with 60 mm/s, short of the goal": (
        "arrives_or_stops",
        record(lambda trace: (
            put("load.position", slice(None), [0.3, 0.0, 0.1])(trace),
            put("load.linear_velocity", slice(500, None), [0.0, 0.0, -0.06])(trace))),
        3000, 50.0, "mm/s"),
    "the events go back in time": (
        "events_complete",
        Record(good_trace(), [told("started", 0), told("joined", 900), told("lost", 700), told("ended", 3000)],
               record().run, record().audit, ()),
        700, 200.0, "ticks"),
    "a process is left": (
        "nobody_left", Record(good_trace(), record().events, record().run, record().audit, ("palanquin follower",)),
        None, 1.0, "processes"),
}  # fmt: skip


@pytest.mark.parametrize(("invariant", "spoiled", "tick", "by", "unit"), SPOILED.values(), ids=SPOILED)
def test_each_is_violated_at_its_tick_and_by_how_much(
    invariant: str, spoiled: Record, tick: int | None, by: float, unit: str
) -> None:
    found = says(invariant, spoiled)
    assert (found.verdict, found.tick, found.unit) == ("violated", tick, unit), found
    assert found.by == pytest.approx(by, rel=1e-9)
    others = [each for each in check_all(spoiled) if each.verdict != "holds" and each.invariant != invariant]
    # A loss of a1 that was scheduled and not told is unknown, besides.
    assert {each.invariant for each in others} <= {"events_complete"}
    assert judge(spoiled).verdict == "violated"


@given(st.floats(-0.5, 0.5))
def test_a_load_violates_its_height_by_what_it_sinks_too_far_and_never_by_rising(sunk: float) -> None:
    found = says("height", record(put("load.position", 50, [0.2, 0.0, 0.1 - sunk])))
    assert (found.verdict == "violated") == (0.1 - (0.1 - sunk) > 0.08)
    if found.verdict == "violated":
        assert found.by == pytest.approx(sunk - 0.08, abs=1e-12)  # three roundings of numbers below 1


def test_a_turn_about_the_vertical_is_no_tilt() -> None:
    assert says("tilt", record(put("load.quat_wxyz", slice(None), [0.6, 0.0, 0.0, 0.8]))).verdict == "holds"


def test_what_strikes_an_arm_is_no_others_failing() -> None:
    struck = record(put("a1.grip", slice(250, None), 0.0), (told("lost", 1000, agent="a1"),), (KILL,))
    assert says("others_carry", struck).verdict == "holds"


def test_an_arm_that_comes_later_is_not_expected_to_hold_before() -> None:
    def comes(trace: dict[str, Any]) -> None:
        trace["a3.grip"][:300] = np.nan
        trace["a3.tau"][:300] = np.nan

    assert judge(record(comes)).verdict == "holds"


def test_a_load_may_move_at_its_goal_and_may_stand_short_of_it() -> None:
    moving = record(put("load.linear_velocity", slice(500, None), [0.06, 0.0, 0.0]))
    assert says("arrives_or_stops", moving).verdict == "holds"
    short = record(lambda trace: trace["load.position"].__imul__([0.5, 1.0, 1.0]))
    assert says("arrives_or_stops", short).verdict == "holds"
    assert judge(short).outcome == "stops"


def test_the_scenarios_own_bound_of_the_goal_counts() -> None:
    off = put("load.position", slice(400, None), [0.8, 0.0, 0.1])
    wide = {"events": [], "load": {"size_m": [1.6, 0.9, 0.75]}, "expect": {"goal_error_m": {"max": 0.3, "min": None}}}
    assert judge(record(off)).outcome == "stops"
    assert judge(record(off, scenario=wide)).outcome == "carries"


ORDERED = told("ordered", 1000, event="kill", agent="a1")
SEEN = told("seen", 1000, event="kill", agent="a1")


def test_a_fault_that_was_not_seen_to_take_effect_makes_the_run_unknown_never_holds() -> None:
    for events in ((), (ORDERED,), (SEEN,), (ORDERED, SEEN | {"agent": "a2"})):
        judgement = judge(record(events=events, schedule=(KILL,)))
        assert judgement.verdict == judgement.outcome == "unknown"
        assert "kill of a1 at 1 s" in judgement.of("events_complete").why
    assert judge(record(events=(ORDERED, SEEN), schedule=(KILL,))).verdict == "holds"


def test_what_the_simulator_calls_unproven_is_unknown_though_it_was_seen_to_end() -> None:
    idle = "event 'loss' of a1 at 1 s was not seen to take effect"
    judgement = judge(record(events=(ORDERED, SEEN), schedule=(KILL,), unproven=[idle]))
    assert judgement.verdict == judgement.outcome == "unknown"
    assert idle in judgement.of("events_complete").why
    several = {"at_s": 1.0, "kind": "restart_storm", "agent": "a1", "times": 1}  # told as a kill and a start
    assert judge(record(events=(ORDERED, SEEN), schedule=(several,), unproven=[])).verdict == "holds"


def test_two_faults_of_one_kind_and_target_need_two_sights() -> None:
    again = KILL | {"at_s": 2.0}
    twice = (ORDERED, SEEN, ORDERED | {"tick": 2000})
    assert unseen_faults((KILL, again), twice) == ["kill of a1 at 2 s"]
    assert unseen_faults((KILL, again), (*twice, SEEN | {"tick": 2000})) == []


def test_a_push_that_is_seen_twice_is_one_fault() -> None:
    """It is told when it acts and when it has ended."""
    push = {"at_s": 1.0, "kind": "push", "arm": None, "point": "front"}
    sight = {"kind": "seen", "event": "push", "point": "front"}
    assert unseen_faults((push, push), ({"kind": "ordered", "event": "push", "point": "front"}, sight, sight)) == [
        "push of front at 1 s"
    ]


def test_what_did_not_reach_its_end_can_violate_but_not_hold() -> None:
    cut = {"completed": False, "why": "the operator stopped it"}
    assert {finding.verdict for finding in check_all(record(ended=cut))} == {"unknown", "holds"}
    assert judge(record(ended=cut)).verdict == judge(record(ended=cut)).outcome == "unknown"
    fell = record(put("load.position", slice(500, None), [0.5, 0.0, 0.0]), ended=cut)
    assert says("height", fell).verdict == "violated"


def test_nobody_looked_and_no_audit_are_unknown_with_their_reasons() -> None:
    of = record()
    bare = Record(of.trace, of.events, of.run)
    assert {each.invariant: each.verdict for each in check_all(bare) if each.verdict != "holds"} == {
        "silence": "unknown", "nobody_left": "unknown",
    }  # fmt: skip
    heard = Record(of.trace, of.events, of.run, {"verdict": "violated", "why": ["a1 listened to a2's key"]}, ())
    assert says("silence", heard).text == "a1 listened to a2's key"
    assert verdict_of(check_all(heard)) == "violated"


def outcome_of(**changed: Any) -> str:
    return judge(record(**changed)).outcome


def test_a_load_that_sank_or_tilted_too_far_is_dropped_wherever_it_ends() -> None:
    assert outcome_of(spoil=put("load.position", 30, [0.5, 0.0, 0.0])) == "drops"
    assert outcome_of(spoil=put("load.quat_wxyz", 30, quat(20.0))) == "drops"


def test_a_load_at_its_goal_that_was_squeezed_too_hard_only_stops() -> None:
    assert outcome_of(spoil=put("a1.grip", 30, [400.0, 0, 0, 0, 0, 0])) == "stops"


def test_a_load_that_goes_on_past_a_loose_hand_moves() -> None:
    def goes_on(trace: dict[str, Any]) -> None:
        trace["load.position"][:, 0] *= 0.5
        trace["load.linear_velocity"][:, 1] = 0.2

    assert outcome_of(spoil=goes_on) == "moves"


def test_bounds_can_be_tighter() -> None:
    assert judge(record(put("load.quat_wxyz", 40, quat(2.0))), Bounds(tilt_max_deg=1.0)).outcome == "drops"


def test_a_folder_is_judged_as_its_record_and_keeps_the_judgement(tmp_path: Path) -> None:
    folder = left_in(tmp_path, record(put("load.quat_wxyz", 40, quat(-7.5)), (ORDERED | {"undone": True},)))
    (folder / COST).write_text('{"wall_s": 1.0, "left_over": ["palanquin sim"]}')
    judgement = judge_folder(folder)
    assert [each.invariant for each in judgement.violated] == ["tilt", "nobody_left"]
    assert json.loads((folder / JUDGEMENT).read_text())["findings"][1]["tick"] == 200
    assert [event["kind"] for event in read_record(folder).events] == ["started", "ended"], "what is undone is not told"


def test_what_is_no_whole_run_is_unknown_and_says_why(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="no run folder"):
        read_record(tmp_path)
    folder = left_in(tmp_path, record(put("load.position", 3, np.nan)))
    judgement: Judgement = judge_folder(folder)
    assert judgement.verdict == judgement.outcome == "unknown"
    assert "hold no numbers" in judgement.findings[0].why
    (folder / TRACE).write_bytes(b"PAR1")
    assert "cannot be judged" in judge_folder(folder).findings[0].why
