"""A law that has shown that it is quick answers on the transport's thread, and nothing else changes by that."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import pytest
from played_simulator import DEADLINE_S, KEYS, ZERO, PlayedSimulator, state

from agents.at_once import QUICK_NS, QUICK_STEPS, AtOnce
from agents.session import AgentSession, RunEnded
from wire.codec import encode
from wire.errors import Reason, Refused
from wire.messages import Command, End, Hello, State


@dataclass
class Law:
    """A follower whose steps take as long as it says, and which notes the threads that it ran on."""

    step_ns: int = 1
    failing: Exception | None = None
    threads: list[str] = field(default_factory=list)
    ticks: list[int] = field(default_factory=list)

    def check(self, state: State) -> None:
        if self.ticks and state.tick <= self.ticks[-1]:
            raise Refused(Reason.STALE, "tick", state.tick, "a newer one")

    def answer(self, state: State, lease: int, period_s: float) -> Command:
        self.threads.append(threading.current_thread().name)
        self.ticks.append(state.tick)
        if self.failing is not None:
            raise self.failing
        return Command("a1", state.tick, lease, ZERO, (0.0,) * 3, 0.0, ZERO, self.step_ns)


class Team:
    """One session and its law, against a simulator that publishes on a thread of its own, as a transport does."""

    def __init__(self) -> None:
        self.simulator, self.law = PlayedSimulator("lock-step"), Law()
        hello = Hello("follower", "test", "a1", "panda", "", 1, "here")
        self.session = AgentSession(self.simulator.broker.link(), KEYS.arm("a1"), KEYS.sim_alive, hello)
        self.session.join(DEADLINE_S)
        self.at_once = AtOnce(self.session, self.law, 1e-3)
        self.tick = 0

    def arrive(self, payload: bytes) -> None:
        """A message comes in, and is dealt with as far as the transport's thread deals with it."""
        transport = threading.Thread(target=lambda: self.simulator.state.put(payload), name="transport")
        transport.start()
        transport.join(DEADLINE_S)

    def tick_once(self) -> str:
        """One state and its answer; the thread that worked it out."""
        self.tick += 1
        self.arrive(state(self.tick))
        if self.simulator.answers.empty():
            self.answer_on_the_main_thread()
        assert self.simulator.command().tick == self.tick
        assert self.simulator.answers.empty(), "one answer a tick"
        return self.law.threads[-1]

    def answer_on_the_main_thread(self) -> None:
        message = self.session.receive(0.0)
        assert isinstance(message, State)
        command = self.law.answer(message, self.session.lease, 1e-3)
        self.at_once.note(command.step_ns)
        self.session.send(command)

    def warm_up(self) -> None:
        main = threading.current_thread().name
        assert [self.tick_once() for _ in range(QUICK_STEPS)] == [main] * QUICK_STEPS


def test_a_law_goes_to_the_transports_thread_after_enough_quick_steps_in_a_row() -> None:
    team = Team()
    for _ in range(QUICK_STEPS - 1):
        team.tick_once()
    team.law.step_ns = QUICK_NS
    team.tick_once()  # a slow one: it begins anew
    team.law.step_ns = QUICK_NS - 1
    team.warm_up()
    assert [team.tick_once() for _ in range(3)] == ["transport"] * 3


def test_a_slow_step_brings_it_back_to_the_main_thread() -> None:
    team = Team()
    team.warm_up()
    team.law.step_ns = QUICK_NS
    assert team.tick_once() == "transport"
    assert team.tick_once() == threading.current_thread().name
    team.law.step_ns = 1
    team.warm_up()
    assert team.tick_once() == "transport"


def test_a_law_that_fails_there_fails_on_the_main_thread() -> None:
    team = Team()
    team.warm_up()
    team.law.failing = ArithmeticError("no torque")
    team.arrive(state(team.tick + 1))
    assert team.simulator.answers.empty()
    with pytest.raises(ArithmeticError, match="no torque"):
        team.session.receive(0.0)


@pytest.mark.parametrize("bad", [b"\xc1 garbage", state(1)], ids=["garbage", "an old state"])
def test_what_does_not_fit_is_left_to_the_main_thread_and_changes_nothing(bad: bytes) -> None:
    team = Team()
    team.warm_up()
    team.tick_once()
    before = list(team.law.ticks)
    team.arrive(bad)
    assert team.simulator.answers.empty()
    assert team.law.ticks == before
    message = team.session.receive(0.0)  # refused there, or shown to who checks it there
    assert message is None or message.tick == 1
    assert team.tick_once() == "transport"


def test_the_end_is_heard_on_the_main_thread() -> None:
    team = Team()
    team.warm_up()
    team.arrive(encode(End("over", "enough")))
    with pytest.raises(RunEnded, match="enough"):
        team.session.receive(0.0)


def test_who_has_left_answers_no_more() -> None:
    team = Team()
    team.warm_up()
    team.session.leave()
    team.arrive(state(team.tick + 1))
    assert team.simulator.answers.empty()
