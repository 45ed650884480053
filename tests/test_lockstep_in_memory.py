"""The lock-step clock over the in-memory wire: who is waited for, what is missed, refused, lost and regained."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from bench import LOST_AFTER, PERIOD_NS, RUN, TIMEOUT_S, Bench, MemoryAgent, ask, obedient, silent

from sim_server.lockstep import Stopped
from sim_server.reception import LEADER
from wire.codec import decode, encode
from wire.errors import Reason
from wire.keys import Keys
from wire.lifecycle import Phase
from wire.messages import Goodbye, Hello, LeaderView, Order, Refusal, State, Welcome

# A tick


def test_all_states_go_out_before_any_command_acts_and_the_step_comes_last() -> None:
    bench = Bench(leader=True)

    def noted(agent: MemoryAgent, state: State | LeaderView) -> None:
        bench.book.append(("state", agent.name, state.tick))
        obedient(agent, state)

    for name in ("a1", "a2", LEADER):
        bench.join(name, noted)
    bench.run(3)
    with_leader = ["read", "state", "state", "state", "command", "command", "pull", "step"]
    without = ["read", "state", "state", "command", "command", "step"]
    assert [entry[0] for entry in bench.book] == with_leader + without + with_leader
    assert bench.commands("a1") == bench.commands("a2") == [0.5, 1.5, 2.5]


def test_a_follower_gets_its_own_senses_and_nothing_of_any_other() -> None:
    bench = Bench()
    a1, a2 = bench.join("a1"), bench.join("a2")
    bench.run(2)
    for k, agent in ((1, a1), (2, a2)):
        expected = [
            State(
                agent.name,
                t,
                t * PERIOD_NS,
                (k + 0.1,) * 7,
                (k + 0.2,) * 7,
                (k + 0.3,) * 7,
                (k + 0.4,) * 6,
                0.03,
                (0.0,) * 6,
            )
            for t in (0, 1)
        ]
        assert agent.seen == expected


def test_the_leader_sees_and_pulls_once_in_its_period() -> None:
    bench = Bench(("a1",), leader=True)
    bench.join("a1")
    leader = bench.join(LEADER)
    assert decode(leader.greeting.replies[0], Welcome).points == {"front": (0.8, 0.0, 0.7)}
    bench.run(5)
    assert [view.tick for view in leader.seen] == [0, 2, 4]
    assert [view.time_ns for view in leader.seen] == [0, 2 * PERIOD_NS, 4 * PERIOD_NS]
    assert [entry for entry in bench.book if entry[0] == "pull"] == [("pull", "front", (3.0, 0.0, 0.0))] * 3


def test_the_order_in_which_answers_come_does_not_matter() -> None:
    """The tick ends when the last has answered, whoever that is."""
    bench = Bench()
    held: list[tuple[MemoryAgent, int]] = []

    def first_waits(agent: MemoryAgent, state: State | LeaderView) -> None:
        held.append((agent, state.tick))
        if agent.name == "a2":
            for each, tick in reversed(held):
                each.command(tick, 7.0)
            held.clear()

    bench.join("a1", first_waits)
    bench.join("a2", first_waits)
    assert bench.run(3) < TIMEOUT_S
    assert [entry[1] for entry in bench.book if entry[0] == "command"] == ["a2", "a1"] * 3
    assert bench.reported("missed") == []


# Missed, late, lost


def test_a_silent_agent_costs_one_timeout_then_is_lost_and_the_others_go_on() -> None:
    bench = Bench()

    def hangs_from_2(agent: MemoryAgent, state: State | LeaderView) -> None:
        if state.tick < 2:
            obedient(agent, state)

    bench.join("a1", hangs_from_2)
    bench.join("a2")
    assert bench.run(2) < TIMEOUT_S
    took = bench.run(LOST_AFTER - 1)
    assert TIMEOUT_S <= took < 2 * TIMEOUT_S  # waited for once, not at every tick
    assert bench.phase("a1") is Phase.TICKING
    assert ("lose", "a1") not in bench.book
    bench.run(1)
    assert bench.phase("a1") is Phase.LOST
    assert bench.book.count(("lose", "a1")) == 1
    assert bench.run(10) < TIMEOUT_S
    assert bench.commands("a1") == [0.5, 1.5]
    assert len(bench.commands("a2")) == 2 + LOST_AFTER + 10
    assert bench.reported("missed") == [{"agent": "a1", "tick_missed": 2}]
    (lost,) = bench.reported("lost")
    assert (lost["agent"], lost["then"]) == ("a1", "limp")
    assert f"{LOST_AFTER} ticks" in lost["why"]


def test_a_late_answer_is_refused_counted_and_changes_nothing_and_the_next_one_in_time_counts_again() -> None:
    bench = Bench(("a1",))

    def late_at_1(agent: MemoryAgent, state: State | LeaderView) -> None:
        if state.tick == 1:
            return
        if state.tick == 2:
            agent.command(1, 99.0)
        agent.command(state.tick, state.tick + 0.5)

    bench.join("a1", late_at_1)
    bench.run(3)
    assert bench.commands("a1") == [0.5, 2.5]
    assert bench.refused("a1") == {Reason.STALE: 1}
    link = bench.reception.agents["a1"].link
    assert (link.phase, link.missed, link.missed_in_row) == (Phase.TICKING, 1, 0)
    assert bench.run(2) < TIMEOUT_S
    assert link.missed == 1


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (lambda agent, tick: agent.command(tick + 1), Reason.FUTURE),
        (lambda agent, tick: agent.command(tick, lease=7), Reason.LEASE),
        (lambda agent, tick: agent.command(tick, arm="a2"), Reason.ARM),
        (lambda agent, tick: agent.command(tick, float("nan")), Reason.NOT_FINITE),
        (lambda agent, tick: agent.publisher.put(b"\xc1"), Reason.MALFORMED),
        (lambda agent, tick: agent.force(tick, (0.0, 0.0, 0.0)), Reason.TYPE),
    ],
)
def test_what_does_not_fit_is_counted_reported_once_and_changes_nothing(
    wrong: Callable[[MemoryAgent, int], None], reason: Reason
) -> None:
    bench = Bench(("a1",))

    def wrong_then_right(agent: MemoryAgent, state: State | LeaderView) -> None:
        wrong(agent, state.tick)
        obedient(agent, state)

    bench.join("a1", wrong_then_right)
    assert bench.run(3) < TIMEOUT_S
    assert bench.commands("a1") == [0.5, 1.5, 2.5]
    assert bench.refused("a1") == {reason: 3}
    (refused,) = bench.reported("refused")
    assert (refused["agent"], refused["reason"]) == ("a1", reason)
    assert bench.reception.refused() == 3


def test_a_second_answer_to_one_tick_does_not_act() -> None:
    bench = Bench(("a1",))

    def twice(agent: MemoryAgent, state: State | LeaderView) -> None:
        obedient(agent, state)
        agent.command(state.tick, 99.0)

    bench.join("a1", twice)
    bench.run(2)
    assert bench.commands("a1") == [0.5, 1.5]
    # The one to the last tick is taken out of the inbox in the same tick.
    assert bench.refused("a1") == {Reason.DUPLICATE: 2}


def test_an_agent_whose_sign_of_life_goes_is_lost_without_waiting() -> None:
    bench = Bench()
    a1 = bench.join("a1")
    bench.join("a2")
    bench.run(2)
    a1.link.close()
    assert bench.run(3) < TIMEOUT_S
    assert bench.phase("a1") is Phase.LOST
    assert bench.book.count(("lose", "a1")) == 1
    (lost,) = bench.reported("lost")
    assert (lost["agent"], lost["why"]) == ("a1", "its sign of life is gone")


def test_an_agent_that_dies_while_it_is_waited_for_ends_the_wait() -> None:
    bench = Bench()

    def dies_at_1(agent: MemoryAgent, state: State | LeaderView) -> None:
        if state.tick < 1:
            obedient(agent, state)
        else:
            agent.link.close()

    bench.join("a1", dies_at_1)
    bench.join("a2")
    assert bench.run(3) < TIMEOUT_S
    assert bench.phase("a1") is Phase.LOST


def test_an_agent_that_says_goodbye_has_left_and_is_not_lost() -> None:
    bench = Bench()
    a1 = bench.join("a1")
    bench.join("a2")
    bench.run(1)
    question = ask(bench.broker, a1.keys.hello, Goodbye("a1", a1.lease))
    bench.settle()
    a1.link.close()
    bench.run(2)
    assert decode(question.replies[0], Goodbye).name == "a1"
    assert bench.phase("a1") is Phase.LEFT
    assert bench.reported("left") == [{"agent": "a1"}]
    assert bench.reported("lost") == []
    assert bench.book.count(("let_down", "a1")) == 1
    assert ("lose", "a1") not in bench.book


# The leader's bounds


@pytest.mark.parametrize(
    ("force", "obeyed"),
    [
        ((40.0, 0.0, 0.0), True),
        ((40.0 + 1e-9, 0.0, 0.0), False),
        ((-24.0, 32.0, 0.0), True),
        ((30.0, 30.0, 0.0), False),
        ((1.0, 0.0, 1e-9), False),  # it may not help to carry
    ],
)
def test_a_pull_above_the_bound_or_out_of_the_plane_is_refused_whole(
    force: tuple[float, float, float], obeyed: bool
) -> None:
    bench = Bench(("a1",), leader=True)
    bench.join("a1")
    bench.join(LEADER, lambda agent, view: agent.force(view.tick, force))
    bench.run(1)
    assert [entry for entry in bench.book if entry[0] == "pull"] == ([("pull", "front", force)] if obeyed else [])
    assert bench.refused(LEADER) == ({} if obeyed else {Reason.RANGE: 1})
    assert bench.reception.agents[LEADER].link.missed == 0, "it did answer, so nobody waits for it"


def test_a_pull_at_a_point_that_the_load_does_not_have_is_refused_with_those_it_has() -> None:
    bench = Bench(("a1",), leader=True)
    bench.join("a1")
    bench.join(LEADER, lambda agent, view: agent.force(view.tick, (1.0, 0.0, 0.0), "middle"))
    bench.run(1)
    assert [entry for entry in bench.book if entry[0] == "pull"] == []
    assert bench.refused(LEADER) == {Reason.POINT: 1}
    assert "front" in bench.reported("refused")[0]["text"]


def test_a_lost_leader_pulls_no_more() -> None:
    bench = Bench(("a1",), leader=True)
    bench.join("a1")
    leader = bench.join(LEADER)
    bench.run(1)
    leader.link.close()
    bench.run(1)
    assert [entry for entry in bench.book if entry[0] == "pull"][-1] == ("pull", "centre", (0.0, 0.0, 0.0))
    assert bench.reported("lost")[0]["then"] == "stops pulling"


# Coming back


def test_a_restarted_agent_regains_its_arm_with_a_new_lease_before_its_first_state() -> None:
    bench = Bench(("a1",))
    old = bench.join("a1")
    bench.run(2)
    assert old.lease == 1
    old.link.close()
    bench.run(1)
    new = bench.join("a1")
    assert new.lease == 2
    assert bench.phase("a1") is Phase.READY
    assert bench.book[-1] == ("regain", "a1")
    bench.run(2)
    assert [state.tick for state in new.seen] == [3, 4]
    assert bench.commands("a1") == [0.5, 1.5, 3.5, 4.5]
    assert [(each["agent"], each["lease"]) for each in bench.reported("joined")] == [("a1", 1), ("a1", 2)]


def test_an_instance_that_was_thought_dead_cannot_drive_the_arm_of_the_new_one() -> None:
    bench = Bench(("a1",))
    old = bench.join("a1", silent)
    bench.run(LOST_AFTER)
    assert bench.phase("a1") is Phase.LOST
    new = bench.join("a1", obedient)

    def haunted(agent: MemoryAgent, state: State | LeaderView) -> None:
        old.command(state.tick, 99.0)
        obedient(agent, state)

    new.behave = haunted
    bench.run(3)
    assert bench.commands("a1") == [tick + 0.5 for tick in range(LOST_AFTER, LOST_AFTER + 3)]
    assert bench.refused("a1") == {Reason.LEASE: 3}
    assert len(new.seen) == 3
    assert "without an answer" in old.ended  # and it was told
    assert not new.ended


def test_a_second_instance_is_refused_and_does_not_disturb_the_first() -> None:
    bench = Bench(("a1",))
    first = bench.join("a1")
    bench.run(1)
    link = bench.broker.link()
    question = ask(bench.broker, first.keys.hello, Hello("follower", RUN, "a1", "panda", "digest", 2, "here"))
    bench.settle()
    link.close()
    refusal = decode(question.replies[0], Refusal)
    assert refusal.reason == Reason.TAKEN
    assert "one instance at a time" in refusal.text
    assert bench.run(3) < TIMEOUT_S
    assert bench.phase("a1") is Phase.TICKING
    assert bench.commands("a1") == [0.5, 1.5, 2.5, 3.5]
    assert bench.reported("lost") == []


@pytest.mark.parametrize(
    ("hello", "reason"),
    [
        (Hello("follower", "other", "a1", "panda", "digest", 1, "here"), Reason.RUN),
        (Hello("follower", RUN, "a2", "panda", "digest", 1, "here"), Reason.ARM),
        (Hello("leader", RUN, "a1", "panda", "digest", 1, "here"), Reason.ROLE),
        (Hello("follower", RUN, "a1", "ur5e", "digest", 1, "here"), Reason.MODEL),
        (Hello("follower", RUN, "a1", "panda", "other", 1, "here"), Reason.DIGEST),
    ],
)
def test_a_greeting_that_does_not_fit_is_refused_with_its_reason_and_the_right_one_still_comes_in(
    hello: Hello, reason: Reason
) -> None:
    bench = Bench(("a1",))
    question = ask(bench.broker, Keys(RUN).arm("a1").hello, hello)
    bench.settle()
    assert decode(question.replies[0], Refusal).reason == reason
    assert bench.phase("a1") is Phase.ABSENT
    assert bench.refused("a1") == {reason: 1}
    assert bench.join("a1").lease == 1


def test_a_greeting_of_an_arm_that_is_not_in_the_run_is_counted_for_nobody() -> None:
    bench = Bench(("a1",))
    hello = Hello("follower", RUN, "a9", "panda", "digest", 1, "here")
    question = ask(bench.broker, Keys(RUN).arm("a9").hello, hello)
    bench.settle()
    assert decode(question.replies[0], Refusal).reason == Reason.ARM
    assert bench.refused("a1") == {}
    assert bench.reception.refused() == 1


def test_an_order_to_stop_stops_before_the_next_step() -> None:
    bench = Bench(("a1",))
    bench.join("a1")
    bench.run(2)
    bench.broker.link().publisher(Keys(RUN).order).put(encode(Order("stop", 0)))
    with pytest.raises(Stopped):
        bench.run(1)
    assert ("step", 1) in bench.book
    assert ("step", 2) not in bench.book
