"""The follower and the leader as processes see them: joined to a hand-played simulator over the in-memory link."""

from __future__ import annotations

import queue
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from played_simulator import DEADLINE_S, KEYS, SETTINGS, ZERO, PlayedSimulator, Q, state, wait_for

import agents.retreat
from agents.arm_model import ArmModel
from agents.departure import Departure
from agents.errors import AgentError, NotWelcome
from agents.follower import Follower, run_follower
from agents.leader import LeaderSettings, pull, run_leader
from agents.pulling import bounded_pull, rotate
from agents.reach import OPEN_M
from agents.session import AgentSession, RunEnded
from wire.codec import decode, decode_any, encode
from wire.errors import Reason
from wire.memory import Broker, MemoryQuestion
from wire.messages import (
    Command,
    End,
    Goodbye,
    Hello,
    LeaderForce,
    LeaderView,
    Leaving,
    Refusal,
    State,
    Vector,
    Welcome,
)

HELLO = Hello("follower", "test", "a1", "panda", "", 1, "here")


def gravity() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return ArmModel("panda").snapshot(np.array(Q), np.zeros(7)).g


def test_a_follower_answers_each_state_with_its_tick_and_lease_until_the_end() -> None:
    simulator = PlayedSimulator("lock-step")
    simulator.follow()
    for tick in (0, 1, 2, 7):
        simulator.state.put(state(tick))
        command = simulator.command()
        assert (command.arm, command.tick, command.lease) == ("a1", tick, 3)
    simulator.state.put(encode(End("over", "enough")))
    assert simulator.ended.get(timeout=DEADLINE_S) == "enough"


def test_in_real_time_a_follower_holds_its_arm_up_when_states_stop_coming() -> None:
    simulator = PlayedSimulator("real-time")
    simulator.follow()
    simulator.state.put(state(5))
    assert simulator.command().tick == 5
    hold = simulator.command()  # nothing was sent to ask for it: the silence did
    assert hold.tick == 5
    # Gravity of its own model and nothing else. The wire carries doubles as they are: equal, not close.
    np.testing.assert_array_equal(hold.torque, gravity())
    assert hold.base_force == (0.0, 0.0, 0.0)
    assert hold.stiffness == ZERO
    simulator.state.put(state(6))
    assert simulator.command().tick == 6, "when states come again it goes on"


def joined(simulator: PlayedSimulator) -> AgentSession[State]:
    session = AgentSession(simulator.broker.link(), KEYS.arm("a1"), KEYS.sim_alive, HELLO, State)
    session.join(DEADLINE_S)
    return session


def test_of_states_that_have_piled_up_only_the_newest_counts_in_real_time() -> None:
    simulator = PlayedSimulator("real-time")
    session = joined(simulator)
    for tick in (4, 6, 5):  # one was overtaken
        simulator.state.put(state(tick))
    simulator.state.put(b"\xc1 garbage")
    newest = session.receive_newest(0.0)
    assert newest is not None
    assert newest.tick == 6
    assert session.receive_newest(0.0) is None


def test_the_end_is_heard_even_where_states_have_piled_up() -> None:
    simulator = PlayedSimulator("real-time")
    session = joined(simulator)
    simulator.state.put(state(4))
    simulator.state.put(encode(End("over", "enough")))
    with pytest.raises(RunEnded, match="enough"):
        session.receive_newest(0.0)


def test_a_follower_that_skipped_states_takes_the_time_between_them_from_the_states() -> None:
    """The law of a follower that saw ticks 1 and 9 has lived through 8 ms: no less than one that is told so."""
    torques = []
    for last, period_s in ((9, 0.001), (9, 0.5)):
        follower = Follower(SETTINGS)
        moved = (*Q[:3], -2.0, *Q[4:])
        for tick, q in ((1, Q), (last, moved)):
            command = follower.answer(decode(state(tick, q=q), State), 3, period_s)
        torques.append(command.torque)
    other = Follower(SETTINGS)
    other.answer(decode(state(8), State), 3, 0.001)
    nearer = other.answer(decode(state(9, q=moved), State), 3, 0.001).torque
    assert torques[0] == torques[1], "the period counts for the first state only"
    assert torques[0] != nearer, "8 ms are not 1 ms"


def test_in_lock_step_silence_is_not_answered_since_time_stands_still() -> None:
    simulator = PlayedSimulator("lock-step")
    simulator.follow()
    simulator.state.put(state(0))
    assert simulator.command().tick == 0
    with pytest.raises(queue.Empty):
        simulator.answers.get(timeout=10 * SETTINGS.state_timeout_s)


@pytest.mark.parametrize(
    "bad",
    [
        pytest.param(state(3, arm="a2"), id="another arm's state"),
        pytest.param(state(0), id="an old state"),
        pytest.param(state(3, q=Q[:6]), id="six joints"),
        pytest.param(b"\xc1 garbage", id="garbage"),
    ],
)
def test_a_state_that_does_not_fit_changes_nothing(bad: bytes) -> None:
    torques = []
    for disturb in (False, True):
        simulator = PlayedSimulator("lock-step")
        simulator.follow()
        for tick in (1, 2):
            simulator.state.put(state(tick))
            simulator.command()
        if disturb:
            simulator.state.put(bad)
        simulator.state.put(state(3, q=(*Q[:6], 0.8)))
        command = simulator.command()
        assert command.tick == 3
        torques.append(command.torque)
    assert torques[0] == torques[1]


def test_a_refusal_at_hello_ends_the_follower_with_the_simulators_reason() -> None:
    simulator = PlayedSimulator(
        "lock-step", lambda: Refusal(Reason.DIGEST, "digest of the arm model: got x, expected y")
    )
    link = simulator.broker.link()
    simulator.start(lambda: run_follower(link, SETTINGS))
    ended = simulator.ended.get(timeout=DEADLINE_S)
    assert isinstance(ended, NotWelcome)
    assert "digest of the arm model: got x, expected y" in str(ended)


def test_a_follower_ends_when_the_simulator_is_gone() -> None:
    simulator = PlayedSimulator("lock-step")
    simulator.follow()
    simulator.link.close()
    ended = simulator.ended.get(timeout=DEADLINE_S)
    assert isinstance(ended, AgentError)
    assert "gone" in str(ended)


class Witness(PlayedSimulator):
    """Notes what is said on the hello key."""

    def __init__(self, clock: Literal["lock-step", "real-time"] = "lock-step", strut: Vector = ZERO) -> None:
        self.said: list[Hello | Leaving | Goodbye] = []
        self.departure = Departure()
        self.settings = replace(SETTINGS, leave_s=0.002, reconnect_s=DEADLINE_S)
        self.broker = Broker()
        self.play(clock, strut=strut)

    def _answer(self, question: MemoryQuestion, reply: Welcome | Refusal) -> None:
        message = decode_any(question.payload)
        assert isinstance(message, Hello | Leaving | Goodbye)
        self.said.append(message)
        question.reply(encode(reply if isinstance(message, Hello) else message))

    def follow(self) -> None:
        link = self.broker.link()
        self.start(lambda: run_follower(link, self.settings, self.departure))
        wait_for(self.state.matched)

    def tick(self, tick: int) -> Command:
        self.state.put(state(tick))
        return self.command()


def test_a_follower_that_is_told_to_leave_says_so_before_its_next_answer_and_answers_on() -> None:
    simulator = Witness()
    simulator.follow()
    before = simulator.tick(0)
    assert simulator.departure.ask()
    wait_for(lambda: simulator.said[1:] == [Leaving("a1", 3)])
    commands = [simulator.tick(tick) for tick in range(1, 8)]
    assert [command.tick for command in commands] == list(range(1, 8))
    assert before.grip_m == commands[0].grip_m == 0.0, "it lets its share down first"
    assert [command.grip_m for command in commands[3:]] == [OPEN_M] * 4, "2 ms later its hand opens"
    simulator.state.put(encode(End("over", "enough")))
    assert simulator.ended.get(timeout=DEADLINE_S) == "enough", "the run may end meanwhile"


def test_a_state_that_comes_with_the_notice_is_answered_by_the_retreat() -> None:
    """The simulator goes on as soon as it has the notice, before the follower has the reply: at which tick the retreat
    begins must not depend on who is quicker."""

    class Quick(Witness):
        def _answer(self, question: MemoryQuestion, reply: Welcome | Refusal) -> None:
            super()._answer(question, reply)
            if isinstance(self.said[-1], Leaving):
                self.state.put(state(5))

    simulator = Quick()
    simulator.settings = replace(simulator.settings, leave_s=0.0)
    simulator.follow()
    for tick in range(5):
        assert simulator.tick(tick).grip_m == 0.0
    assert simulator.departure.ask()
    command = simulator.command()
    assert (command.tick, command.grip_m) == (5, OPEN_M)
    assert [simulator.tick(tick).grip_m for tick in range(6, 9)] == [OPEN_M] * 3


def test_the_goodbye_is_the_answer_to_the_state_after_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """So it arrives between two ticks that are certain, and the run repeats byte for byte."""
    monkeypatch.setattr(agents.retreat, "PATIENCE_S", 0.0105)
    simulator = Witness()
    simulator.follow()
    simulator.tick(0)
    simulator.departure.ask()
    wait_for(lambda: len(simulator.said) == 2)
    for tick in range(1, 14):
        simulator.tick(tick)
    assert simulator.said[2:] == []
    simulator.state.put(state(14))
    assert simulator.ended.get(timeout=DEADLINE_S) == "left in order"
    assert simulator.said[2:] == [Goodbye("a1", 3)]
    assert simulator.answers.empty()


def test_a_follower_that_reaches_turns_back_with_open_fingers() -> None:
    simulator = Witness(strut=(1.5, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0))
    simulator.follow()
    simulator.tick(0)
    simulator.departure.ask()
    wait_for(lambda: len(simulator.said) == 2)
    assert simulator.tick(1).grip_m == OPEN_M


def test_a_departure_is_seen_to_once_and_only_by_one_who_is_in() -> None:
    departure = Departure()
    assert not departure.ask(), "nobody hears it: end at once"
    simulator = Witness()
    link = simulator.broker.link()
    session = AgentSession(link, KEYS.arm("a1"), KEYS.sim_alive, HELLO, State)
    departure.heard_by(session.wake)
    assert not departure.ask(), "not let in yet"
    session.join(DEADLINE_S)
    assert departure.ask()
    assert session.receive(DEADLINE_S) is None, "it wakes up for that"
    assert not departure.ask(), "asked again: in a hurry"
    simulator.link.close()
    with pytest.raises(AgentError, match="gone"):
        session.receive(DEADLINE_S)
    departure = Departure()
    departure.heard_by(session.wake)
    assert not departure.ask(), "not in any more"


def test_a_follower_that_was_leaving_a_simulator_that_died_leaves_the_next_one() -> None:
    first = Witness()
    first.follow()
    first.tick(0)
    first.departure.ask()
    wait_for(lambda: len(first.said) == 2)
    first.link.close()
    second = first  # the same place, another simulator
    second.said = []
    second.play("lock-step", strut=(1.5, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0))
    wait_for(lambda: second.said[1:] == [Leaving("a1", 3)])
    command = second.tick(0)
    assert command.grip_m == OPEN_M, "its hand had opened by then: it goes on from there"


def test_the_leader_answers_every_view_and_refuses_a_point_that_the_load_lacks() -> None:
    simulator = PlayedSimulator("lock-step")
    link = simulator.broker.link()
    simulator.start(lambda: run_leader(link, LeaderSettings("test", (2.0, 0.0))))
    wait_for(simulator.view.matched)
    simulator.view.put(encode(LeaderView(10, 0, (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)))
    force = decode(simulator.answers.get(timeout=DEADLINE_S), LeaderForce)
    assert (force.tick, force.lease, force.point) == (10, 3, "front")
    assert force.force[0] == pytest.approx(40.0)  # 2 m * 40 N/m is above the bound of 40 N
    other = PlayedSimulator("lock-step")
    link = other.broker.link()
    other.start(lambda: run_leader(link, LeaderSettings("test", (2.0, 0.0), point="nose")))
    ended = other.ended.get(timeout=DEADLINE_S)
    assert isinstance(ended, AgentError)
    assert "nose" in str(ended)
    assert "front" in str(ended)


def test_the_pull_is_proportional_damped_and_never_above_its_bound() -> None:
    # By hand: 40 * (0.3, -0.4) - 120 * (0.05, 0) = (6, -16) N, below the bound of 40 N.
    np.testing.assert_allclose(bounded_pull(np.array([0.3, -0.4]), np.array([0.05, 0.0]), 40, 120, 40), [6.0, -16.0])
    rng = np.random.default_rng(1)
    for _ in range(1000):
        error, velocity = rng.normal(size=2) * 10 ** rng.uniform(-3, 3), rng.normal(size=2)
        force = bounded_pull(error, velocity, 40, 120, 40)
        assert np.linalg.norm(force) <= 40.0, "no tolerance: the simulator refuses what is above"
        wanted = 40 * error - 120 * velocity
        # Shortened, not turned: parallel to what was wanted (relative rounding of the product).
        assert force @ wanted == pytest.approx(np.linalg.norm(force) * np.linalg.norm(wanted), rel=1e-9)


def test_the_leader_damps_the_velocity_of_the_point_it_pulls() -> None:
    # By hand: the load spins at 1 rad/s about z, turned by 90 deg: `front`, 0.8 m ahead in O, is at (0, 0.8) and moves
    # at (-0.8, 0) m/s. At its goal only the damping acts: -10 * (-0.8, 0) = (8, 0) N.
    half = np.sqrt(0.5)
    view = LeaderView(0, 0, (2.0, 0.0, 0.1), (half, 0.0, 0.0, half), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    settings = LeaderSettings("test", (2.0, 0.0), stiffness_N_m=40, damping_Ns_m=10)
    np.testing.assert_allclose(pull(view, np.array([0.8, 0.0, 0.7]), settings), [8.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(rotate(np.array([half, 0, 0, half]), np.array([1.0, 2.0, 3.0])), [-2.0, 1.0, 3.0])


def test_a_message_for_somebody_else_is_counted_as_refused_and_not_answered() -> None:
    simulator = PlayedSimulator("lock-step")
    session = joined(simulator)
    simulator.state.put(encode(LeaderView(1, 0, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)))
    simulator.state.put(encode(HELLO))
    assert session.receive(0.0) is None
    assert session.receive(0.0) is None
    assert session.refused == {Reason.TYPE: 2}


def test_the_leader_answers_no_view_twice() -> None:
    simulator = PlayedSimulator("lock-step")
    link = simulator.broker.link()
    simulator.start(lambda: run_leader(link, LeaderSettings("test", (2.0, 0.0))))
    wait_for(simulator.view.matched)
    for tick in (10, 10, 5, 11):
        simulator.view.put(encode(LeaderView(tick, 0, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)))
    ticks = [decode(simulator.answers.get(timeout=DEADLINE_S), LeaderForce).tick for _ in range(2)]
    assert ticks == [10, 11]
    assert simulator.answers.empty()
