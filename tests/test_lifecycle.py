"""The life of an agent as the simulator sees it: which steps are legal, and that no network adds others."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import astuple, replace
from itertools import product
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from wire.errors import MisuseError, Reason, Refused
from wire.lifecycle import TRANSITIONS, AgentLink, Event, Invitation, Phase, check_hello
from wire.messages import Command, Goodbye, Hello, LeaderForce

JOINTS = 7
INVITATION = Invitation("transport", "follower", "a1", "panda", "0a" * 32, JOINTS, lost_after=3)
HELLO = Hello("follower", "transport", "a1", "panda", "0a" * 32, 4711, "bench-7")


def command(tick: int, lease: int) -> Command:
    seven = (0.5,) * JOINTS
    return Command("a1", tick, lease, seven, (0.0, 0.0, 0.0), seven, 1000)


def unchanged(link: AgentLink, wanted: type[Exception], call: Callable[[], object]) -> Exception:
    """Check that the call raises and leaves every slot of the link as it was; return what it raised."""
    before = deepcopy(astuple(link))
    with pytest.raises(wanted) as raised:
        call()
    assert astuple(link) == before
    return raised.value


def refused(link: AgentLink, call: Callable[[], object]) -> Reason:
    error = unchanged(link, Refused, call)
    assert isinstance(error, Refused)
    return error.reason


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


@pytest.mark.parametrize("phase", set(Phase) - {Phase.TICKING})
def test_an_answer_counts_only_while_ticking(phase: Phase) -> None:
    link = link_in(phase)
    assert refused(link, lambda: link.answer(command(5, link.lease))) == Reason.PHASE


@pytest.mark.parametrize("phase", [Phase.ABSENT, Phase.LOST, Phase.LEFT])
def test_one_who_is_not_in_cannot_leave_or_vanish(phase: Phase) -> None:
    link = link_in(phase)
    assert refused(link, lambda: link.goodbye(Goodbye("a1", link.lease))) == Reason.PHASE
    before = astuple(link)
    assert link.vanish() is False
    assert astuple(link) == before


@pytest.mark.parametrize("phase", set(Phase) - {Phase.HELLO})
def test_a_link_comes_up_only_after_a_greeting(phase: Phase) -> None:
    link = link_in(phase)
    unchanged(link, MisuseError, link.matched)


@pytest.mark.parametrize("phase", set(Phase) - {Phase.READY, Phase.TICKING})
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
    assert refused(link, lambda: link.answer(replace(command(5, 1), **changed))) == reason
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


def test_the_leader_s_answer_follows_the_same_rules_without_joints() -> None:
    leader = Invitation("transport", "leader", "leader", "", "", 0, lost_after=3)
    link = AgentLink(leader)
    assert link.greet(Hello("leader", "transport", "leader", "", "", 1, "bench-7")) == 1
    link.matched()
    link.state_sent(0)
    pull = LeaderForce(0, 1, "front", (40.0, 0.0, 0.0))
    assert refused(link, lambda: link.answer(replace(pull, tick=1))) == Reason.FUTURE
    assert refused(link, lambda: link.answer(replace(pull, lease=2))) == Reason.LEASE
    link.answer(pull)
    assert refused(link, lambda: link.answer(pull)) == Reason.DUPLICATE


# The greeting

WRONG_HELLO: dict[Reason, dict[str, Any]] = {
    Reason.RUN: {"run": "doorway"},
    Reason.ARM: {"name": "a2"},
    Reason.ROLE: {"role": "leader"},
    Reason.MODEL: {"arm_model": "ur5e"},
    Reason.DIGEST: {"digest": "0a" * 31 + "0b"},
}


def test_a_greeting_that_fits_is_let_in() -> None:
    check_hello(HELLO, INVITATION)
    check_hello(replace(HELLO, pid=1, host="elsewhere"), INVITATION)


@pytest.mark.parametrize(("reason", "changed"), WRONG_HELLO.items(), ids=WRONG_HELLO)
def test_a_greeting_with_one_thing_wrong_is_refused_for_that(reason: Reason, changed: dict[str, Any]) -> None:
    wrong = replace(HELLO, **changed)
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


# Any order of events, over a network that drops, doubles, reorders and delays


class AnyNetwork(RuleBasedStateMachine):
    """A simulator, instances of one agent that come and go, and the answers that are on their way between them.

    The model keeps what an outsider would write down: who is in, with which lease, and the fate of every tick.
    """

    @initialize(lost_after=st.integers(1, 4))
    def start(self, lost_after: int) -> None:
        self.lost_after = lost_after
        self.link = AgentLink(replace(INVITATION, lost_after=lost_after))
        self.is_in = self.is_connected = False
        self.newest_lease = 0
        self.newest_tick = -1
        self.fate: dict[int, str] = {}
        """Of every tick sent: ``open``, ``answered``, ``given up``, or ``dropped`` when the agent went meanwhile."""
        self.owner: dict[int, int] = {}
        """The lease that every tick was sent to."""
        self.misses = 0
        self.accepted: list[tuple[int, int]] = []
        self.in_flight: list[Command] = []

    @property
    def is_ticking(self) -> bool:
        """A state went to the present instance."""
        return self.is_in and self.owner.get(self.newest_tick) == self.newest_lease

    def is_open(self) -> bool:
        return self.fate.get(self.newest_tick) == "open"

    def go(self) -> None:
        self.is_in = self.is_connected = False
        if self.is_open():
            self.fate[self.newest_tick] = "dropped"

    # The agent

    @rule()
    def greet(self) -> None:
        if self.is_connected:
            assert refused(self.link, lambda: self.link.greet(HELLO)) == Reason.TAKEN
            return
        lease = self.link.greet(HELLO)
        assert lease > self.newest_lease
        self.newest_lease, self.is_in, self.misses = lease, True, 0

    @rule(reason=st.sampled_from(sorted(WRONG_HELLO)))
    def greet_wrongly(self, reason: Reason) -> None:
        wrong = replace(HELLO, **WRONG_HELLO[reason])
        assert refused(self.link, lambda: self.link.greet(wrong)) == reason

    @rule()
    def vanish(self) -> None:
        assert self.link.vanish() is self.is_in
        self.go()

    @rule(behind=st.integers(-1, 2))
    def say_goodbye(self, behind: int) -> None:
        message = Goodbye("a1", self.newest_lease - behind)
        if behind:
            assert refused(self.link, lambda: self.link.goodbye(message)) == Reason.LEASE
        elif not self.is_in:
            assert refused(self.link, lambda: self.link.goodbye(message)) == Reason.PHASE
        else:
            self.link.goodbye(message)
            assert self.link.phase is Phase.LEFT
            self.go()

    # The simulator

    @rule()
    def match(self) -> None:
        if self.is_in and not self.is_connected:
            self.link.matched()
            self.is_connected = True
        else:
            unchanged(self.link, MisuseError, self.link.matched)

    @rule(ahead=st.integers(1, 3))
    def send_state(self, ahead: int) -> None:
        tick = self.newest_tick + ahead
        if not self.is_connected or self.is_open():
            unchanged(self.link, MisuseError, lambda: self.link.state_sent(tick))
            return
        self.link.state_sent(tick)
        self.newest_tick = tick
        self.fate[tick], self.owner[tick] = "open", self.newest_lease

    @rule(behind=st.integers(0, 3))
    def send_an_old_state(self, behind: int) -> None:
        unchanged(self.link, MisuseError, lambda: self.link.state_sent(self.newest_tick - behind))

    @rule()
    def give_up(self) -> None:
        if not self.is_open():
            unchanged(self.link, MisuseError, self.link.miss)
            return
        self.misses += 1
        self.fate[self.newest_tick] = "given up"
        assert self.link.miss() is (self.misses == self.lost_after)
        if self.misses == self.lost_after:
            self.go()
            assert self.link.phase is Phase.LOST

    @rule(answered=st.lists(st.booleans(), max_size=8))
    def run(self, answered: list[bool]) -> None:
        """The usual course, so that long rows of answers and of misses come up too."""
        if not self.is_in:
            self.greet()
        if not self.is_connected:
            self.match()
        for each in answered:
            if not self.is_connected:  # lost on the way
                break
            if not self.is_open():
                self.send_state(1)
            if each:
                self.arrive(command(self.newest_tick, self.newest_lease))
                assert self.fate[self.newest_tick] == "answered"
            else:
                self.give_up()

    # The network

    @rule(behind=st.integers(-2, 3), lease_behind=st.integers(-1, 2))
    def answer(self, behind: int, lease_behind: int) -> None:
        """An instance, present or old, answers a tick, present, old or never sent."""
        self.in_flight.append(command(self.newest_tick - behind, self.newest_lease - lease_behind))

    @rule()
    def answer_properly(self) -> None:
        self.in_flight.append(command(self.newest_tick, self.newest_lease))

    @precondition(lambda self: self.in_flight)
    @rule(data=st.data(), doubled=st.booleans())
    def deliver(self, data: st.DataObject, doubled: bool) -> None:
        """Any of those on their way: in any order and however late; once more if doubled."""
        place = data.draw(st.integers(0, len(self.in_flight) - 1))
        self.arrive(self.in_flight[place] if doubled else self.in_flight.pop(place))

    @precondition(lambda self: self.in_flight)
    @rule(data=st.data())
    def drop(self, data: st.DataObject) -> None:
        self.in_flight.pop(data.draw(st.integers(0, len(self.in_flight) - 1)))

    @rule(changed=st.sampled_from([{"arm": "a2"}, {"torque": (0.5,) * 6}, {"stiffness": (0.5,) * 8}]))
    def answer_for_another_arm(self, changed: dict[str, Any]) -> None:
        wrong = replace(command(self.newest_tick, self.newest_lease), **changed)
        assert refused(self.link, lambda: self.link.answer(wrong)) in (Reason.ARM, Reason.LENGTH)

    def arrive(self, answer: Command) -> None:
        if answer.lease == self.newest_lease and self.is_ticking and answer.tick == self.newest_tick and self.is_open():
            self.link.answer(answer)
            self.fate[answer.tick] = "answered"
            self.misses = 0
            self.accepted.append((answer.lease, answer.tick))
            return
        reason = refused(self.link, lambda: self.link.answer(answer))
        if answer.lease != self.newest_lease:
            assert reason == Reason.LEASE
        elif not self.is_ticking:
            assert reason == Reason.PHASE
        elif answer.tick not in self.fate and answer.tick > self.newest_tick:
            assert reason == Reason.FUTURE
        elif answer.tick == self.newest_tick and self.fate[answer.tick] == "answered":
            assert reason == Reason.DUPLICATE
        else:
            assert reason == Reason.STALE

    # What holds at all times

    @invariant()
    def the_link_is_where_the_model_says(self) -> None:
        link = self.link
        assert link.lease == self.newest_lease
        assert link.last_tick == self.newest_tick
        assert link.open_tick == (self.newest_tick if self.is_open() else None)
        assert link.missed_in_row == self.misses
        assert link.missed == list(self.fate.values()).count("given up")
        if self.is_ticking:
            assert link.phase is Phase.TICKING
        elif self.is_in:
            assert link.phase is (Phase.READY if self.is_connected else Phase.HELLO)
        else:
            assert link.phase in (Phase.ABSENT, Phase.LOST, Phase.LEFT)

    @invariant()
    def answers_are_accepted_once_per_tick_in_order_and_from_no_old_instance(self) -> None:
        ticks = [tick for _, tick in self.accepted]
        leases = [lease for lease, _ in self.accepted]
        assert ticks == sorted(set(ticks))
        assert leases == sorted(leases)
        assert all(self.owner[tick] == lease for lease, tick in self.accepted)

    @invariant()
    def a_lost_agent_has_missed_just_enough_ticks_or_lost_its_sign_of_life(self) -> None:
        assert self.misses <= self.lost_after
        assert not (self.is_in and self.misses == self.lost_after)


AnyNetwork.TestCase.settings = settings(
    max_examples=150, stateful_step_count=40, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
TestAnyNetworkLeavesOneAnswerPerTickOfTheOneWhoIsIn = AnyNetwork.TestCase
