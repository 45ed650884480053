"""An agent whose simulator goes away waits, greets the one that comes, and forgets what came from the one before."""

from __future__ import annotations

import pytest

from agents.errors import NotWelcome
from agents.session import AgentSession, SimulatorGone
from wire.codec import decode_any, encode
from wire.errors import Reason
from wire.keys import Keys
from wire.memory import Broker, MemoryLink, MemoryQuestion
from wire.messages import Hello, Message, Refusal, State, Welcome

KEYS = Keys("memory")
HELLO = Hello("follower", "memory", "a1", "panda", "digest", 1, "here")


class Simulator:
    """Answers greetings as it is told, one after the other, and listens to commands."""

    def __init__(self, broker: Broker, *replies: Message) -> None:
        self.link: MemoryLink = broker.link()
        self.replies = list(replies)
        self.greeted: list[Message] = []
        self.link.answer_queries(KEYS.arm("a1").hello, self._answer)
        self.link.subscribe(KEYS.arm("a1").command, lambda _: None)
        self.state = self.link.publisher(KEYS.arm("a1").state)
        self.link.declare_alive(KEYS.sim_alive)

    def _answer(self, question: MemoryQuestion) -> None:
        self.greeted.append(decode_any(question.payload))
        question.reply(encode(self.replies.pop(0)))


def welcome(lease: int) -> Welcome:
    return Welcome(lease, "lock-step", 1_000_000, {}, 0.0, 0.0, (0.0,) * 7)


def refusal(reason: Reason) -> Refusal:
    return Refusal(reason, f"because of {reason}")


def state(tick: int) -> bytes:
    return encode(State("a1", tick, 1000 * tick, (0.0,) * 7, (0.0,) * 7, (0.0,) * 7, (0.0,) * 6, 0.03, (0.0,) * 6))


def bereaved(broker: Broker) -> AgentSession[State]:
    """A session whose simulator has sent something and died."""
    first = Simulator(broker, welcome(1))
    session = AgentSession(broker.link(), KEYS.arm("a1"), KEYS.sim_alive, HELLO, State)
    session.join(1.0)
    first.state.put(state(41))
    first.link.close()
    return session


def test_what_came_before_the_death_is_read_and_then_the_death() -> None:
    session = bereaved(Broker())
    assert isinstance(message := session.receive(0.0), State)
    assert message.tick == 41
    with pytest.raises(SimulatorGone, match="a1: the simulator is gone"):
        session.receive(0.0)


def test_a_simulator_that_comes_back_is_greeted_anew_and_the_past_is_forgotten() -> None:
    broker = Broker()
    session = bereaved(broker)
    second = Simulator(broker, welcome(1002))
    assert session.rejoin(1.0) == welcome(1002)
    assert session.lease == 1002
    assert second.greeted == [HELLO]
    second.state.put(state(40))  # of a time before the death
    assert isinstance(message := session.receive(0.0), State)
    assert message.tick == 40
    assert session.receive(0.0) is None
    assert [key for _, key in broker.tokens].count(KEYS.arm("a1").alive) == 1


def test_a_simulator_that_has_not_noticed_the_loss_is_asked_again() -> None:
    """Only the connection was cut: to the simulator the old instance is still in for a while."""
    broker = Broker()
    session = bereaved(broker)
    second = Simulator(broker, refusal(Reason.TAKEN), refusal(Reason.TAKEN), welcome(2))
    assert session.rejoin(5.0).lease == 2
    assert len(second.greeted) == 3


def test_another_refusal_is_the_end() -> None:
    broker = Broker()
    session = bereaved(broker)
    Simulator(broker, refusal(Reason.DIGEST))
    with pytest.raises(NotWelcome, match="because of digest"):
        session.rejoin(5.0)


def test_at_the_first_greeting_a_place_that_is_taken_is_the_end() -> None:
    broker = Broker()
    Simulator(broker, refusal(Reason.TAKEN))
    session = AgentSession(broker.link(), KEYS.arm("a1"), KEYS.sim_alive, HELLO, State)
    with pytest.raises(NotWelcome, match="because of taken"):
        session.join(5.0)


def test_a_simulator_that_does_not_come_back_is_waited_for_no_longer_than_told() -> None:
    session = bereaved(Broker())
    with pytest.raises(SimulatorGone, match=r"has not come back within 0\.05 s"):
        session.rejoin(0.05)
