"""Shrinking on a fake runner: the cause is known, and it alone is left."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.chaos.shrink import HALVINGS, fewest, shrink

Events = Sequence[dict[str, Any]]


def events(count: int) -> list[dict[str, Any]]:
    return [{"at_s": float(k), "kind": "push", "arm": f"a{k}", "force_N": [80.0, 0.0, -8.0]} for k in range(count)]


class Runner:
    """Fails whenever the culprits are there, each strong enough."""

    def __init__(self, culprits: set[str], force_N: float = 0.0) -> None:
        self._culprits, self._force_N = culprits, force_N
        self.runs: list[list[dict[str, Any]]] = []

    def __call__(self, tried: Events) -> bool:
        self.runs.append(list(tried))
        strong = {event["arm"] for event in tried if event["force_N"][0] >= self._force_N}
        return self._culprits <= strong


@given(st.integers(1, 12).flatmap(lambda n: st.tuples(st.just(n), st.sets(st.integers(0, n - 1), min_size=1))))
def test_exactly_the_culprits_are_left_in_order(drawn: tuple[int, set[int]]) -> None:
    count, culprits = drawn
    left = fewest(events(count), Runner({f"a{k}" for k in culprits}))
    assert [event["arm"] for event in left] == [f"a{k}" for k in sorted(culprits)]


@given(st.floats(0.1, 80.0))
def test_the_strength_that_is_left_still_fails_and_is_near_the_least(least_N: float) -> None:
    shrunk = shrink(events(5), Runner({"a3"}, least_N))
    (left,) = shrunk.events
    assert shrunk.is_done
    assert left["force_N"][0] >= least_N
    assert left["force_N"][0] <= least_N + 80.0 * 0.5**HALVINGS + 1e-3  # rounding to three digits
    assert left["force_N"][2] == pytest.approx(-0.1 * left["force_N"][0], abs=2e-3), "a vector keeps its direction"


def test_durations_and_counts_shrink_and_moments_joints_and_names_stay() -> None:
    event = {"at_s": 3.0, "kind": "x", "arm": "a1", "for_s": 1.6, "times": 5, "joint": 6, "on": True}
    (left,) = shrink([event], lambda tried: bool(tried)).events
    assert left["for_s"] == 0.025
    assert left["times"] == 1
    assert {**left, "for_s": 1.6, "times": 5} == event


def test_what_does_nothing_at_one_shrinks_towards_one() -> None:
    event = {"at_s": 3.0, "kind": "torque_loss", "arm": "a1", "joint": 2, "factor": 0.2}
    (left,) = shrink([event], lambda tried: bool(tried) and tried[0]["factor"] <= 0.65).events
    assert 0.55 <= left["factor"] <= 0.65


def test_what_the_failure_does_not_need_costs_few_tries() -> None:
    event = {"at_s": 3.0, "kind": "fail_grasp", "arm": "a1", "for_s": 1.6, "force_N": 40.0}
    assert shrink([event], lambda tried: bool(tried)).tries == 4, "the whole, nothing, and a 64th of either strength"


def test_events_that_need_each_other_stay_together() -> None:
    """A start without its kill is no schedule: it does not fail, and is no reason to stop."""
    story = [{"at_s": float(k), "kind": kind} for k, kind in enumerate(("kill", "push", "start", "push", "leave"))]

    def fails(tried: Events) -> bool:
        kinds = [event["kind"] for event in tried]
        return "start" in kinds and "kill" in kinds

    assert [event["kind"] for event in shrink(story, fails).events] == ["kill", "start"]


def test_no_schedule_is_tried_twice_and_no_more_than_allowed() -> None:
    runner = Runner({"a1", "a6"}, 17.0)
    shrunk = shrink(events(9), runner, most=500)
    assert shrunk.is_done
    assert len({str(run) for run in runner.runs}) == len(runner.runs) == shrunk.tries
    few = Runner({"a1", "a6"}, 17.0)
    cut = shrink(events(9), few, most=6)
    assert len(few.runs) == cut.tries == 6
    assert not cut.is_done
    assert Runner({"a1", "a6"}, 17.0)(cut.events), "what is left when the tries are used up fails nevertheless"


def test_what_fails_without_any_event_is_left_with_none() -> None:
    assert shrink(events(4), lambda tried: True).events == []


def test_what_does_not_fail_cannot_be_shrunk() -> None:
    with pytest.raises(ValueError, match="does not fail"):
        shrink(events(3), lambda tried: False)
