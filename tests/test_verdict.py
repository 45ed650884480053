"""The verdict: bounds against metrics."""

from __future__ import annotations

import math

import pytest

from sim_server.scenario import Bound
from sim_server.verdict import Judged, judge, overall, why_unknown


@pytest.mark.parametrize(
    ("bound", "value", "verdict"),
    [
        (Bound(max=0.1), 0.1, "holds"),  # a bound belongs to what it allows
        (Bound(max=0.1), math.nextafter(0.1, 1), "violated"),
        (Bound(min=2.0), 2.0, "holds"),
        (Bound(min=2.0), math.nextafter(2.0, 0), "violated"),
        (Bound(min=-1, max=1), 0, "holds"),
        (Bound(min=-1, max=1), -1.5, "violated"),
        (Bound(min=-1, max=1), 1.5, "violated"),
        (Bound(max=0), 0, "holds"),
        (Bound(max=0), -0.0, "holds"),
        (Bound(max=1), math.nan, "violated"),
    ],
)
def test_a_number_is_held_against_both_its_bounds(bound: Bound, value: float, verdict: str) -> None:
    (row,) = judge({"tilt_max_deg": value}, {"tilt_max_deg": bound})
    assert row.verdict == verdict


@pytest.mark.parametrize("metrics", [{}, {"goal_error_m": None}, {"goal_error_m": {"a1": 0.0}}, {"goal_error_m": "0"}])
def test_what_was_not_measured_is_neither_held_nor_violated(metrics: dict[str, object]) -> None:
    (row,) = judge(metrics, {"goal_error_m": Bound(max=1)})
    assert (row.verdict, row.value) == ("unknown", None)


def test_each_bound_is_judged_by_its_own_metric_in_the_scenarios_order() -> None:
    rows = judge({"a": 1.0, "b": 5.0, "c": 0.0}, {"c": Bound(max=1), "b": Bound(max=1), "a": Bound(min=1)})
    assert [(row.metric, row.value, row.verdict) for row in rows] == [
        ("c", 0.0, "holds"),
        ("b", 5.0, "violated"),
        ("a", 1.0, "holds"),
    ]
    assert [row.expected for row in rows] == ["<= 1", "<= 1", ">= 1"]
    assert Judged("d", 0.0, Bound(min=0, max=0.5), "holds").expected == ">= 0 and <= 0.5"


def rows_of(*verdicts: str) -> tuple[Judged, ...]:
    values = {"holds": 0.0, "violated": 2.0, "unknown": None}
    return judge({v: values[v] for v in verdicts}, {v: Bound(max=1) for v in verdicts})


@pytest.mark.parametrize(
    ("verdicts", "completed", "verdict"),
    [
        ((), True, "holds"),
        ((), False, "unknown"),
        (("holds",), True, "holds"),
        (("holds",), False, "unknown"),  # the bound held so far; what would have come is not known
        (("holds", "unknown"), True, "unknown"),
        (("unknown", "violated"), True, "violated"),
        (("violated", "holds"), True, "violated"),
        (("violated",), False, "unknown"),  # a goal not reached yet is not a goal missed
    ],
)
def test_only_a_run_that_ended_is_judged_and_then_one_violation_decides(
    verdicts: tuple[str, ...], completed: bool, verdict: str
) -> None:
    rows = rows_of(*verdicts)
    assert [row.verdict for row in rows] == list(verdicts)
    assert overall(rows, completed) == verdict


@pytest.mark.parametrize("verdicts", [(), ("holds",), ("violated",), ("unknown",)])
def test_a_fault_that_was_not_seen_makes_any_verdict_unknown(verdicts: tuple[str, ...]) -> None:
    assert overall(rows_of(*verdicts), True, ["event 'loss' of a2 at 1 s was not seen to take effect"]) == "unknown"


def test_whatever_makes_a_verdict_unknown_is_told() -> None:
    rows = rows_of("holds", "unknown", "violated")
    assert why_unknown(rows, None, []) == ["unknown does not exist for this run"]
    assert why_unknown(rows[:1], "stopped", ["an event was not seen"]) == [
        "the run did not reach its end: stopped",
        "an event was not seen",
    ]
    assert why_unknown(rows[:1], None, []) == []
