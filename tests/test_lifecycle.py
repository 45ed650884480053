"""The life of an agent as the simulator sees it: which steps are legal."""

from __future__ import annotations

from dataclasses import astuple, replace
from itertools import product
from typing import Any

import pytest
from msgspec import structs
from one_link import HELLO, INVITATION, WRONG_HELLO, command, refused, unchanged

from wire.errors import MisuseError, Reason, Refused
from wire.lifecycle import TRANSITIONS, AgentLink, Event, Invitation, Phase, check_hello
from wire.messages import Goodbye, Hello, LeaderForce, Leaving


def link_in(phase: Phase) -> AgentLink:
    """A link that came to the phase on a legal path, with lease 1, and tick 5 open if it is ticking."""
    link = AgentLink(INVITATION)
    if phase is Phase.ABSENT:
        return link
    link.greet(HELLO)
    if phase in (Phase.READY, Phase.TICKING):
        link.matched()
    if phase is Phase.TICKING:
        link.state_sent(5)
    if phase is Phase.LOST:
        link.vanish()
    if phase is Phase.LEFT:
        link.goodbye(Goodbye("a1", 1))
    assert link.phase is phase
    return link


# The table


ILLEGAL = [pair for pair in product(Phase, Event) if pair not in TRANSITIONS]


@pytest.mark.parametrize(("phase", "event"), ILLEGAL, ids=[f"{phase}-{event}" for phase, event in ILLEGAL])
def test_a_step_that_the_table_lacks_is_misuse_and_changes_nothing(phase: Phase, event: Event) -> None:
    link = link_in(phase)
    unchanged(link, MisuseError, lambda: link._move(event))


@pytest.mark.parametrize(("phase", "event"), TRANSITIONS, ids=[f"{phase}-{event}" for phase, event in TRANSITIONS])
def test_a_step_of_the_table_leads_where_the_table_says(phase: Phase, event: Event) -> None:
    link = link_in(phase)
    link._move(event)
    assert link.phase is TRANSITIONS[phase, event]


def ways_to(goal: Phase) -> set[tuple[Phase, Event]]:
    return {step for step, after in TRANSITIONS.items() if after is goal and step[0] is not goal}


def ways_from(start: Phase) -> set[tuple[Event, Phase]]:
    return {(event, after) for (phase, event), after in TRANSITIONS.items() if phase is start}


def test_only_one_who_is_in_can_be_lost_or_leave() -> None:
    being_in = {Phase.HELLO, Phase.READY, Phase.TICKING}
    assert ways_to(Phase.LOST) == {(phase, Event.VANISHED) for phase in being_in} | {(Phase.TICKING, Event.STRUCK_OUT)}
    assert ways_to(Phase.LEFT) == {(phase, Event.SAID_GOODBYE) for phase in being_in}


@pytest.mark.parametrize("phase", [Phase.ABSENT, Phase.LOST, Phase.LEFT])
def test_the_only_way_in_is_a_greeting(phase: Phase) -> None:
    assert ways_from(phase) == {(Event.GREETED, Phase.HELLO)}


def test_nobody_is_driven_before_the_link_is_up_in_both_directions() -> None:
    assert ways_to(Phase.READY) == {(Phase.HELLO, Event.MATCHED)}
    assert ways_to(Phase.TICKING) == {(Phase.READY, Event.STATE_SENT)}
    assert ways_to(Phase.ABSENT) == set()


# What each call does where it is not legal: the peer's fault is refused, our own raises MisuseError


@pytest.mark.parametrize("phase", [Phase.READY, Phase.TICKING])
def test_a_second_greeting_finds_the_place_taken(phase: Phase) -> None:
    link = link_in(phase)
    assert refused(link, lambda: link.greet(HELLO)) == Reason.TAKEN


def test_a_welcome_that_was_lost_can_be_asked_for_again() -> None:
    link = link_in(Phase.HELLO)
    first = link.lease
    assert link.greet(HELLO) > first
    assert link.phase is Phase.HELLO


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.TICKING}))
def test_an_answer_counts_only_while_ticking(phase: Phase) -> None:
    link = link_in(phase)
    assert refused(link, lambda: link.answer(command(5, link.lease))) == Reason.PHASE


@pytest.mark.parametrize("phase", [Phase.HELLO, Phase.READY, Phase.TICKING])
def test_one_who_says_that_it_leaves_stays_in_until_its_goodbye(phase: Phase) -> None:
    link = link_in(phase)
    for _ in range(2):
        link.begin_to_leave(Leaving("a1", 1))
        assert (link.phase, link.leaving) == (phase, True)
    if phase is Phase.TICKING:
        link.answer(command(5, 1))
    link.goodbye(Goodbye("a1", 1))
    assert link.phase is Phase.LEFT
    link.greet(HELLO)
    assert not link.leaving, "the next instance has not said so"


@pytest.mark.parametrize("phase", [Phase.ABSENT, Phase.LOST, Phase.LEFT])
def test_one_who_is_not_in_cannot_leave_or_vanish(phase: Phase) -> None:
    link = link_in(phase)
    assert refused(link, lambda: link.begin_to_leave(Leaving("a1", link.lease))) == Reason.PHASE
    assert refused(link, lambda: link.goodbye(Goodbye("a1", link.lease))) == Reason.PHASE
    before = astuple(link)
    assert link.vanish() is False
    assert astuple(link) == before


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.HELLO}))
def test_a_link_comes_up_only_after_a_greeting(phase: Phase) -> None:
    link = link_in(phase)
    unchanged(link, MisuseError, link.matched)


@pytest.mark.parametrize("phase", sorted(set(Phase) - {Phase.READY, Phase.TICKING}))
def test_a_state_for_one_who_is_not_in_is_misuse(phase: Phase) -> None:
    link = link_in(phase)
    unchanged(link, MisuseError, lambda: link.state_sent(9))
    unchanged(link, MisuseError, link.miss)


def test_ticks_go_up_one_open_at_a_time() -> None:
    link = link_in(Phase.TICKING)
    unchanged(link, MisuseError, lambda: link.state_sent(6))  # 5 is open
    link.answer(command(5, 1))
    unchanged(link, MisuseError, lambda: link.state_sent(5))
    unchanged(link, MisuseError, lambda: link.state_sent(4))
    unchanged(link, MisuseError, link.miss)  # nothing is open
    link.state_sent(6)
    assert link.open_tick == 6


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"arm": "a2"}, Reason.ARM),
        ({"lease": 0}, Reason.LEASE),
        ({"lease": 2}, Reason.LEASE),
        ({"tick": 6}, Reason.FUTURE),
        ({"tick": 4}, Reason.STALE),
        ({"torque": (0.5,) * 6}, Reason.LENGTH),
        ({"torque": (0.5,) * 8}, Reason.LENGTH),
        ({"stiffness": (0.5,) * 6}, Reason.LENGTH),
    ],
    ids=str,
)
def test_an_answer_with_one_thing_wrong_is_refused_for_that(changed: dict[str, Any], reason: Reason) -> None:
    link = link_in(Phase.TICKING)
    assert refused(link, lambda: link.answer(structs.replace(command(5, 1), **changed))) == reason
    link.answer(command(5, 1))


def test_a_second_answer_is_a_duplicate_and_a_late_one_is_stale() -> None:
    link = link_in(Phase.TICKING)
    for tick in (5, 7):  # in the second round there has been a miss before
        link.answer(command(tick, 1))
        assert refused(link, lambda: link.answer(command(link.last_tick, 1))) == Reason.DUPLICATE
        link.state_sent(tick + 1)
        assert not link.miss()
        assert refused(link, lambda: link.answer(command(link.last_tick, 1))) == Reason.STALE
        link.state_sent(tick + 2)


@pytest.mark.parametrize("lost_after", [1, 2, 3, 20])
def test_lost_means_so_many_misses_in_a_row_and_an_answer_starts_the_count_again(lost_after: int) -> None:
    link = AgentLink(replace(INVITATION, lost_after=lost_after))
    link.greet(HELLO)
    link.matched()
    tick = 0
    for misses in (lost_after - 1, lost_after - 1, lost_after):
        for k in range(1, misses + 1):
            tick += 1
            link.state_sent(tick)
            assert link.miss() is (k == lost_after)
        if misses < lost_after:
            tick += 1
            link.state_sent(tick)
            link.answer(command(tick, 1))
    assert link.phase is Phase.LOST
    assert link.missed == 3 * lost_after - 2


@pytest.mark.parametrize(
    ("goodbye", "reason"),
    [(Goodbye("a2", 1), Reason.ARM), (Goodbye("a1", 0), Reason.LEASE), (Goodbye("a1", 2), Reason.LEASE)],
)
def test_nobody_can_say_goodbye_for_another(goodbye: Goodbye, reason: Reason) -> None:
    link = link_in(Phase.TICKING)
    assert refused(link, lambda: link.goodbye(goodbye)) == reason
    assert refused(link, lambda: link.begin_to_leave(Leaving(goodbye.name, goodbye.lease))) == reason


def test_the_leader_s_answer_follows_the_same_rules_without_joints() -> None:
    leader = Invitation("transport", "leader", "leader", "", "", 0, lost_after=3)
    link = AgentLink(leader)
    assert link.greet(Hello("leader", "transport", "leader", "", "", 1, "bench-7")) == 1
    link.matched()
    link.state_sent(0)
    pull = LeaderForce(0, 1, "front", (40.0, 0.0, 0.0))
    assert refused(link, lambda: link.answer(structs.replace(pull, tick=1))) == Reason.FUTURE
    assert refused(link, lambda: link.answer(structs.replace(pull, lease=2))) == Reason.LEASE
    link.answer(pull)
    assert refused(link, lambda: link.answer(pull)) == Reason.DUPLICATE


# The greeting


def test_a_greeting_that_fits_is_let_in() -> None:
    check_hello(HELLO, INVITATION)
    check_hello(structs.replace(HELLO, pid=1, host="elsewhere"), INVITATION)


@pytest.mark.parametrize(("reason", "changed"), WRONG_HELLO.items(), ids=WRONG_HELLO)
def test_a_greeting_with_one_thing_wrong_is_refused_for_that(reason: Reason, changed: dict[str, Any]) -> None:
    wrong = structs.replace(HELLO, **changed)
    with pytest.raises(Refused) as refusal:
        check_hello(wrong, INVITATION)
    assert refusal.value.reason == reason
    link = link_in(Phase.ABSENT)
    assert refused(link, lambda: link.greet(wrong)) == reason


def test_refusals_are_counted_by_reason() -> None:
    link = link_in(Phase.TICKING)
    for reason in (Reason.STALE, Reason.LEASE, Reason.STALE):
        link.count_refusal(reason)
    assert link.refused == {"stale": 2, "lease": 1}


# A simulator that is started again


@pytest.mark.parametrize("phase", list(Phase))
def test_who_was_in_is_awaited_and_greets_anew_and_who_was_out_stays_out(phase: Phase) -> None:
    before, link = link_in(phase), AgentLink(INVITATION)
    before.missed, before.longest_miss = 7, 3
    before.count_refusal(Reason.STALE)
    was_in = phase in (Phase.HELLO, Phase.READY, Phase.TICKING)
    assert link.resume(before.state()) is was_in
    assert link.phase is (phase if phase in (Phase.LOST, Phase.LEFT) else Phase.ABSENT)
    kept = (link.missed, link.longest_miss, link.states_sent, link.last_tick, link.refused)
    assert kept == (7, 3, before.states_sent, before.last_tick, {Reason.STALE: 1})
    lease = link.greet(HELLO)
    assert lease > before.lease + 100  # so many instances may have been let in after the state was taken
    link.matched()
    link.state_sent(6)
    assert refused(link, lambda: link.answer(command(6, lease=1))) is Reason.LEASE
    link.answer(command(6, lease=lease))


def test_a_life_with_a_phase_that_there_is_not_is_no_life() -> None:
    with pytest.raises(ValueError, match="asleep"):
        AgentLink(INVITATION).resume(AgentLink(INVITATION).state() | {"phase": "asleep"})
