"""No network adds a step to the life of an agent, whatever it drops, doubles, reorders and delays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from msgspec import structs
from one_link import HELLO, INVITATION, WRONG_HELLO, command, refused, unchanged

from wire.errors import MisuseError, Reason
from wire.lifecycle import AgentLink, Phase
from wire.messages import Command, Goodbye, Leaving

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
        self.leaver = -1
        """The lease of the last instance that said that it leaves."""
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
        wrong = structs.replace(HELLO, **WRONG_HELLO[reason])
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

    @rule(behind=st.integers(-1, 2))
    def say_that_it_leaves(self, behind: int) -> None:
        message = Leaving("a1", self.newest_lease - behind)
        if behind or not self.is_in:
            reason = refused(self.link, lambda: self.link.begin_to_leave(message))
            assert reason == (Reason.LEASE if behind else Reason.PHASE)
        else:
            self.link.begin_to_leave(message)
            self.leaver = self.newest_lease

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
        wrong = structs.replace(command(self.newest_tick, self.newest_lease), **changed)
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
        assert link.leaving == (self.leaver == self.newest_lease)
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


AnyNetwork.TestCase.settings = settings(max_examples=150, stateful_step_count=40)
TestAnyNetworkLeavesOneAnswerPerTickOfTheOneWhoIsIn = AnyNetwork.TestCase
