"""Message faults: what they do to the messages, what the clocks make of it, and that the same seed does the same."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bench import LOST_AFTER, TIMEOUT_S, Bench, MemoryAgent, silent
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from played_simulator import DEADLINE_S, PlayedSimulator, wait_for
from processes import read_events, read_json
from test_happenings import Stage
from test_realtime import RealBench
from test_resume import KILLED_AT, begin, go_on

from agents.follower import Follower, FollowerSettings
from agents.leader import LeaderSettings, run_leader
from sim_server.errors import ScenarioError
from sim_server.faults.edge import SETTINGS, Edge
from sim_server.faults.message import MessageEvent
from sim_server.reception import LEADER
from sim_server.scenario_events import AnyEvent
from sim_server.scenario_files import load_scenario
from sim_server.snapshot import pack, unpack
from wire.codec import decode, decode_any, encode
from wire.errors import Reason, Refused
from wire.lifecycle import Phase
from wire.messages import Command, End, LeaderForce, LeaderView, State

PATIENCE_S = 30.0
REQUIRED: dict[str, dict[str, Any]] = {"wrong_arm": {"name": "a7"}}


def fault(kind: str, direction: str = "from", at_s: float = 0.0, **keys: Any) -> MessageEvent:
    given_ = {"kind": kind, "arm": "a2", "direction": direction, "at_s": at_s, **REQUIRED.get(kind, {}), **keys}
    event = SETTINGS[kind].model_validate(given_)
    assert isinstance(event, MessageEvent)
    return event


def patient(*events: AnyEvent, leader: bool = False) -> Stage:
    """A stage on which waiting in vain cannot be mistaken for a slow machine."""
    return Stage(*events, timeout_s=PATIENCE_S, leader=leader)


def last_words(stage: Stage) -> str:
    stage.happenings.before(stage.tick)
    return str(stage.bench.reported("seen")[-1]["effect"])


# What lock-step makes of it


@pytest.mark.parametrize("direction", ["to", "from"])
def test_a_lost_message_is_a_missed_tick_at_once_and_the_count_is_that_of_the_misses(direction: str) -> None:
    stage = patient(fault("loss", direction, 0.010, for_s=0.040, probability=0.3))
    assert stage.run(60) < PATIENCE_S, "nobody waits for what will not come"
    link = stage.bench.reception.agents["a2"].link
    assert 5 < link.missed < 20  # 12 of 40 with a deviation of 3
    assert last_words(stage) == f"it has ended: {link.missed} of 40 messages lost"
    came = [int(torque) for torque in stage.bench.commands("a2")]
    assert [tick for tick in range(60) if tick not in came] == [tick for tick in range(10, 50) if tick not in came], (
        "outside its time nothing is lost"
    )
    assert len(came) == 60 - link.missed
    assert len(stage.agents["a2"].seen) == (60 - link.missed if direction == "to" else 60)
    assert stage.bench.commands("a1") == [tick + 0.5 for tick in range(60)]
    assert stage.bench.reported("lost") == []


@pytest.mark.parametrize("direction", ["to", "from"])
def test_a_burst_as_long_as_what_loses_an_arm_loses_it_without_any_wait(direction: str) -> None:
    stage = patient(fault("burst_loss", direction, 0.003, probability=1.0, burst_ticks=LOST_AFTER))
    assert stage.run(3 + LOST_AFTER - 1) < PATIENCE_S
    assert stage.bench.phase("a2") is Phase.TICKING
    assert stage.run(3) < PATIENCE_S
    (lost,) = stage.bench.reported("lost")
    assert (lost["agent"], lost["missed_ticks"]) == ("a2", LOST_AFTER)


def test_bursts_are_as_long_as_told() -> None:
    edge, lost = Edge(5), []
    edge.begin(fault("burst_loss", probability=0.05, burst_ticks=7), None)
    for tick in range(2000):
        lost.append(not edge.receive("a2", tick, b"x"))
    runs = "".join("x" if each else "." for each in lost).strip("x").split(".")
    lengths = [len(run) for run in runs if run]
    assert len(lengths) > 20
    assert set(lengths) <= {7, 14, 21}, "two bursts may follow each other"


@pytest.mark.parametrize(("kind", "late"), [("delay", 2), ("reorder", 1)])
def test_a_late_command_is_refused_as_stale_and_its_tick_is_missed(kind: str, late: int) -> None:
    keys = {"delay_ticks": 2} if kind == "delay" else {"probability": 1.0}
    stage = patient(fault(kind, "from", 0.010, for_s=0.003, **keys))
    assert stage.run(30) < PATIENCE_S
    missed = [10, 11, 12] if kind == "delay" else [10, 12]  # the one in between follows the one that waited
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in range(30) if tick not in missed]
    assert stage.bench.refused("a2") == {Reason.STALE: len(missed)}
    words = "late" if kind == "delay" else "sent after the next"
    assert last_words(stage) == f"it has ended: {len(missed)} of 3 messages {words}"


def test_a_late_state_is_answered_late_and_one_that_was_overtaken_is_not() -> None:
    stage = patient(fault("delay", "to", 0.010, for_s=0.003, delay_ticks=2))
    stage.agents["a2"].behave = as_the_wire_says()
    assert stage.run(30) < PATIENCE_S
    assert [state.tick for state in stage.agents["a2"].seen] == [*range(12), 13, 12, *range(14, 30)]
    # 10 and 11 come before anything newer and are answered, too late; 13 overtakes 12.
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in range(30) if tick not in (10, 11, 12)]
    assert stage.bench.refused("a2") == {Reason.STALE: 2}
    swapped = patient(fault("reorder", "to", 0.010, for_s=0.001, probability=1.0))
    swapped.agents["a2"].behave = as_the_wire_says()
    assert swapped.run(20) < PATIENCE_S
    assert [state.tick for state in swapped.agents["a2"].seen] == [*range(10), 11, 10, *range(12, 20)]
    assert swapped.bench.commands("a2") == [tick + 0.5 for tick in range(20) if tick != 10]
    assert swapped.bench.refused("a2") == {}


def test_jitter_is_within_its_bound_and_takes_every_delay() -> None:
    edge, sent, came = Edge(3), 1000, {}
    edge.begin(fault("jitter", "to", jitter_ticks=3), None)
    for tick in range(sent + 4):
        out = [payload for payload in edge.send("a2", tick, 1, 7, b"%d" % tick)[0] if int(payload) < sent]
        came.update({int(payload): tick for payload in out})
    assert sorted(came) == list(range(sent)), "none is lost"
    delays = [tick - number for number, tick in came.items()]
    for each in range(4):
        assert 180 < delays.count(each) < 320  # a quarter of 1000, five deviations of 14


def test_a_doubled_command_is_refused_once_as_a_duplicate_and_a_doubled_state_is_answered_once() -> None:
    stage = patient(fault("duplicate", "from", 0.010, for_s=0.005), fault("duplicate", "to", 0.020, for_s=0.005))
    stage.agents["a2"].behave = as_the_wire_says()
    assert stage.run(30) < PATIENCE_S
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in range(30)]
    assert stage.bench.refused("a2") == {Reason.DUPLICATE: 5}
    assert len(stage.agents["a2"].seen) == 35


def test_stale_messages_are_those_of_so_many_before() -> None:
    stage = patient(fault("stale", "to", 0.010, for_s=0.005, age_ticks=3))
    stage.agents["a2"].behave = as_the_wire_says()
    assert stage.run(20) < PATIENCE_S
    seen = [state.tick for state in stage.agents["a2"].seen]
    assert seen == [*range(10), 10, 10, 10, 10, 11, *range(15, 20)]
    # Of them only the new ones are answered: 10 in time, 11 three ticks late.
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in (*range(11), *range(15, 20))]
    assert stage.bench.refused("a2") == {Reason.STALE: 1}
    assert last_words(stage) == "it has ended: 4 of 5 messages replaced by an older one"


@pytest.mark.parametrize(
    ("kind", "reason"), [("truncate", None), ("nan", Reason.NOT_FINITE), ("wrong_arm", Reason.ARM)]
)
def test_spoiled_commands_are_refused_by_the_decoder_and_counted_with_its_reason(
    kind: str, reason: Reason | None
) -> None:
    stage = patient(fault(kind, "from", 0.010, for_s=0.004))
    assert stage.run(30) < PATIENCE_S
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in range(30) if not 10 <= tick < 14]
    refused = stage.bench.refused("a2")
    assert sum(refused.values()) == 4
    assert reason is None or set(refused) == {reason}
    words = last_words(stage)
    if kind == "wrong_arm":
        assert words == "it has ended: 4 of 4 messages with another arm's name"
    else:
        told = ", ".join(f"{times} refused as {each}" for each, times in sorted(refused.items()))
        assert words.endswith(f"4 of 4 messages {'cut off' if kind == 'truncate' else 'with a NaN'}: {told}")


def test_a_flipped_bit_is_one_bit_and_nothing_but_the_rules_decides_what_becomes_of_it() -> None:
    command = encode(Command("a2", 7, 1, (0.5,) * 7, (0.0,) * 3, 0.0, (0.0,) * 7, 0.0, 0))
    edge, outcomes = Edge(2), set()
    edge.begin(fault("bit_flip"), None)
    for tick in range(300):
        (spoiled,) = edge.receive("a2", tick, command)
        different = int.from_bytes(spoiled, "big") ^ int.from_bytes(command, "big")
        assert different.bit_count() == 1
        try:
            decode_any(spoiled)
            outcomes.add("believed")
        except Refused as refusal:
            outcomes.add(str(refusal.reason))
    assert {"believed", "malformed", "unknown_field", "missing_field"} & outcomes >= {"believed", "malformed"}
    edge.finish()
    (seen,) = edge.news
    assert seen.effect.startswith("until the run's end: 300 of 300 messages with wrong bits: ")


def test_faults_of_one_arm_act_one_after_the_other_in_the_order_of_their_beginnings() -> None:
    edge = Edge()
    edge.begin(fault("duplicate"), None)
    edge.begin(fault("delay", delay_ticks=1), None)
    assert edge.receive("a2", 5, b"x") == []
    assert edge.late("a2", 6) == [b"x", b"x"]
    assert edge.receive("a2", 6, b"y") == []
    assert edge.late("a2", 7) == [b"y", b"y"]


def test_an_agent_that_hangs_while_messages_are_lost_still_costs_one_timeout() -> None:
    stage = Stage(fault("loss", "from", 0.0, probability=0.5))
    stage.run(3)
    stage.agents["a2"].behave = silent
    assert TIMEOUT_S <= stage.run(LOST_AFTER + 2) < 2 * TIMEOUT_S
    assert stage.bench.phase("a2") is Phase.LOST


def as_the_wire_says() -> Callable[[MemoryAgent, Any], None]:
    """Answers a state exactly if it is newer than all before, as docs/wire.md has it."""
    newest = -1

    def behave(agent: MemoryAgent, state: Any) -> None:
        nonlocal newest
        if state.tick > newest:
            newest = state.tick
            agent.command(state.tick, state.tick + 0.5)

    return behave


# Who will answer


@pytest.fixture(scope="module")
def follower() -> Follower:
    return Follower(FollowerSettings("memory", "a2", "panda", "paper", {}))


kinds = st.sampled_from(sorted(SETTINGS))


@settings(max_examples=60, deadline=None)
@given(st.lists(kinds, min_size=1, max_size=3), st.integers(0, 2**32), st.floats(0.1, 1.0))
def test_the_edge_knows_which_states_the_shipped_follower_answers(
    follower: Follower, chain: list[str], seed: int, probability: float
) -> None:
    edge = Edge(seed)
    for kind in chain:
        edge.begin(fault(kind, "to", probability=probability), 40)
    follower._last = None
    for tick in range(50):
        edge.settle(tick)
        state = State("a2", tick, tick * 10**6, (0.1 * tick,) * 7, (0.2,) * 7, (0.3,) * 7, (0.4,) * 6, 0.03, (0.0,) * 6)
        out, answers = edge.send("a2", tick, 1, 7, encode(state))
        answered = []
        for payload in out:
            try:
                message = decode_any(payload)
                if not isinstance(message, State):
                    continue  # as the follower's session does
                follower.check(message)
            except Refused:
                continue
            follower._last = message
            answered.append(message.tick)
        assert answers == bool(answered)
        if answered:
            for answer in answered[:-1]:
                assert edge.is_last("a2", a_command(answer)) == (answer >= answered[-1])
            assert edge.is_last("a2", a_command(answered[-1]))


def a_command(tick: int) -> bytes:
    return encode(Command("a2", tick, 1, (0.0,) * 7, (0.0,) * 3, 0.0, (0.0,) * 7, 0.0, 0))


# The same again, and going on


@pytest.mark.parametrize("kind", sorted(SETTINGS))
def test_the_same_seed_does_the_same_and_another_another(kind: str) -> None:
    keys: dict[str, Any] = {} if kind in ("delay", "duplicate", "stale") else {"probability": 0.5}

    def made(seed: int, first: int = 0) -> list[list[bytes]]:
        edge = Edge(seed)
        edge.begin(fault(kind, **keys), None)
        return [edge.late("a2", tick) + edge.receive("a2", tick, a_command(tick)) for tick in range(first, 60)]

    assert made(1) == made(1)
    if kind not in ("delay", "duplicate", "stale"):
        assert made(1) != made(2)
    if kind in ("loss", "truncate", "bit_flip", "nan", "wrong_arm", "duplicate"):
        assert made(1, 20) == made(1)[20:], "what a tick draws does not depend on the ticks before"


@pytest.mark.parametrize("kind", ["truncate", "bit_flip", "nan", "wrong_arm"])
def test_what_a_command_reports_of_wall_time_changes_nothing_of_what_a_fault_makes_of_it(kind: str) -> None:
    made = []
    for step_ns in (7, 300, 90_000, 20_000_000_000):
        edge = Edge(1)
        edge.begin(fault(kind), None)
        command = structs.replace(decode(a_command(3), Command), step_ns=step_ns)
        made.append([edge.receive("a2", tick, encode(command)) for tick in range(50)])
    assert made[1:] == made[:1] * 3


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(kinds, st.sampled_from(["to", "from"])), min_size=1, max_size=4), st.integers(0, 99))
def test_an_edge_that_was_saved_goes_on_byte_for_byte(chain: list[tuple[str, str]], seed: int) -> None:
    edge = Edge(seed)
    for number, (kind, direction) in enumerate(chain):
        edge.begin(fault(kind, direction), None if number else 30)

    def drive(one: Edge, ticks: range) -> list[Any]:
        found: list[Any] = []
        for tick in ticks:
            one.settle(tick)
            found += [one.send("a2", tick, 2, 7, a_command(tick))[0], one.late("a2", tick)]
            found.append(one.receive("a2", tick, a_command(tick)))
        return found

    drive(edge, range(20))
    other = Edge(seed)
    other.restore(unpack(pack(edge.state())))
    assert pack(other.state()) == pack(edge.state())
    assert drive(edge, range(20, 50)) == drive(other, range(20, 50))
    assert pack(other.state()) == pack(edge.state())


FAULTS = {
    "events": [
        {"at_s": 0.010, "kind": "loss", "arm": "a1", "direction": "from", "probability": 0.3},
        {"at_s": 0.020, "kind": "jitter", "arm": "a2", "direction": "to", "jitter_ticks": 2, "for_s": 0.06},
        {"at_s": 0.030, "kind": "bit_flip", "arm": "a2", "direction": "from", "probability": 0.2, "for_s": 0.05},
        {"at_s": 0.040, "kind": "truncate", "arm": "a1", "direction": "to", "probability": 0.2},
    ]
}


def test_two_runs_with_message_faults_leave_the_same_bytes_and_tell_what_was_done(tmp_path: Path) -> None:
    for name in ("one", "two"):
        begin(tmp_path / name, FAULTS)
    one, two = ((tmp_path / name / "trace.parquet").read_bytes() for name in ("one", "two"))
    assert one == two
    begin(tmp_path / "other", {**FAULTS, "seed": 2})
    assert (tmp_path / "other" / "trace.parquet").read_bytes() != one
    events = read_events(tmp_path / "one")
    ordered = [(each["tick"], each["event"]) for each in events if each["kind"] == "ordered"]
    assert ordered == [(10, "loss"), (20, "jitter"), (30, "bit_flip"), (40, "truncate")]
    seen = {each["event"]: each["effect"] for each in events if each["kind"] == "seen"}
    assert seen.keys() == {"loss", "jitter", "bit_flip", "truncate"}
    agents = read_json(tmp_path / "one" / "run.json")["agents"]
    lost, spoiled = (int(seen[kind].split(": ")[1].split()[0]) for kind in ("loss", "truncate"))
    assert agents["a1"]["missed_ticks"] <= lost + spoiled  # a tick whose state was spoiled has no answer to be lost
    assert agents["a1"]["missed_ticks"] >= max(lost, spoiled) > 0


def test_a_run_that_was_killed_with_message_faults_goes_on_with_them_and_repeats(tmp_path: Path) -> None:
    bytes_ = set()
    for name in ("one", "two"):
        assert begin(tmp_path / name, FAULTS, KILLED_AT) is None
        outcome, _ = go_on(tmp_path / name)
        assert outcome is not None
        assert outcome.completed
        bytes_.add((tmp_path / name / "trace.parquet").read_bytes())
    assert len(bytes_) == 1
    seen = [each["event"] for each in read_events(tmp_path / "one") if each["kind"] == "seen" and each["tick"] >= 60]
    assert {"loss", "jitter", "bit_flip", "truncate"} == set(seen)


NOTHING = [{"at_s": 0.010, "kind": "loss", "arm": "a1", "direction": "to", "probability": 1e-12}]


@pytest.mark.parametrize(
    ("events", "verdict"), [(FAULTS["events"], "violated"), ([*FAULTS["events"], *NOTHING], "unknown")]
)
def test_a_run_with_a_fault_that_was_not_seen_is_unknown_and_says_which(
    events: list[dict[str, Any]], verdict: str, tmp_path: Path
) -> None:
    outcome = begin(tmp_path / "run", {"events": events})  # too short to come to its goal
    assert outcome is not None
    assert outcome.verdict == verdict
    metrics = read_json(tmp_path / "run" / "metrics.json")
    missing = [event["text"] for event in read_events(tmp_path / "run") if event["kind"] == "unproven"]
    assert missing == read_json(tmp_path / "run" / "run.json")["unproven"] == metrics.get("why_unknown", [])
    if verdict == "unknown":
        assert missing == ["event 'loss' of a1 at 0.01 s was not seen to take effect"]
        assert missing[0] in outcome.why


# The leader's messages: a view every other tick here, and a pull for each


def pulled(stage: Stage) -> list[int]:
    """Ticks of the views whose pulls acted."""
    return [int(entry[2][0]) for entry in stage.bench.book if entry[0] == "pull"]


def led(*events: AnyEvent) -> Stage:
    """A stage whose leader pulls with as many newtons as the view has ticks, as the wire says."""
    stage, newest = patient(*events, leader=True), -1

    def behave(agent: MemoryAgent, view: Any) -> None:
        nonlocal newest
        if view.tick > newest:
            newest = view.tick
            agent.force(view.tick, (float(min(view.tick, 40)), 0.0, 0.0))

    stage.agents[LEADER].behave = behave
    return stage


def lead_fault(kind: str, direction: str, at_s: float = 0.010, **keys: Any) -> MessageEvent:
    return fault(kind, direction, at_s, arm=LEADER, **keys)


@pytest.mark.parametrize("direction", ["to", "from"])
def test_a_lost_view_or_pull_is_a_missed_tick_of_the_leader_at_once_and_of_nobody_else(direction: str) -> None:
    stage = led(lead_fault("loss", direction, for_s=0.006, probability=1.0))
    assert stage.run(30) < PATIENCE_S
    assert pulled(stage) == [tick for tick in range(0, 30, 2) if tick not in (10, 12, 14)]
    assert stage.bench.reception.agents[LEADER].link.missed == 3
    assert last_words(stage) == "it has ended: 3 of 3 messages lost"
    assert stage.bench.commands("a1") == stage.bench.commands("a2") == [tick + 0.5 for tick in range(30)]
    told = [each for each in stage.bench.reported("seen") if each["event"] == "loss"]
    assert {each["agent"] for each in told} == {LEADER}


@pytest.mark.parametrize("direction", ["to", "from"])
@pytest.mark.parametrize("delay_ticks", [1, 2, 3])
def test_a_late_view_or_pull_comes_at_its_tick_though_the_leader_has_none_then(
    direction: str, delay_ticks: int
) -> None:
    stage = led(lead_fault("delay", direction, for_s=0.003, delay_ticks=delay_ticks))
    assert stage.run(30) < PATIENCE_S
    missed = [10, 12]
    # A view of tick 12 that comes after that of 14 is answered no more.
    late = 2 if direction == "from" or delay_ticks < 3 else 1
    assert pulled(stage) == [tick for tick in range(0, 30, 2) if tick not in missed]
    assert stage.bench.refused(LEADER) == {Reason.STALE: late}
    assert last_words(stage) == "it has ended: 2 of 2 messages late"
    if direction == "to":
        seen = [view.tick for view in stage.agents[LEADER].seen]
        assert sorted(seen) == list(range(0, 30, 2)), "none is lost"


def test_in_which_tick_late_answers_are_refused_does_not_depend_on_how_long_they_take() -> None:
    """Also where several views come at once in a tick that has none of its own: all answers are waited for."""

    def slow(stage: Stage) -> None:
        answer, views = stage.agents[LEADER].behave, queue.SimpleQueue[Any]()
        stage.agents[LEADER].behave = lambda agent, view: views.put((agent, view))

        def work() -> None:
            while True:
                agent, view = views.get()
                time.sleep(0.002)
                answer(agent, view)

        threading.Thread(target=work, daemon=True).start()

    refused: list[list[int]] = []
    for is_slow in (False, True):
        # Two views each, so that the leader is not lost.
        stage = led(*(lead_fault("jitter", "to", 0.02 * k, for_s=0.004, jitter_ticks=5) for k in range(1, 50)))
        if is_slow:
            slow(stage)
        refused.append([])
        for _ in range(1000):
            stage.run(1)
            refused[-1].append(stage.bench.refused(LEADER).get(Reason.STALE, 0))
    assert refused[0] == refused[1]
    steps = [after - before for before, after in zip(refused[0], refused[0][1:], strict=False)]
    assert 2 in steps[::2], "two at once, in a tick without a view"


@pytest.mark.parametrize("direction", ["to", "from"])
def test_a_view_or_pull_that_waits_for_the_next_one_goes_by_itself_when_the_fault_has_ended(direction: str) -> None:
    stage = led(lead_fault("reorder", direction, for_s=0.001, probability=1.0))
    assert stage.run(30) < PATIENCE_S
    assert pulled(stage) == [tick for tick in range(0, 30, 2) if tick != 10]
    assert stage.bench.refused(LEADER) == ({Reason.STALE: 1})
    assert stage.bench.clock.edge.troubled == set()


@pytest.mark.parametrize("kind", ["truncate", "nan"])
def test_a_spoiled_pull_is_refused_and_the_pull_before_stays(kind: str) -> None:
    stage = led(lead_fault(kind, "from", for_s=0.004))
    assert stage.run(30) < PATIENCE_S
    assert pulled(stage) == [tick for tick in range(0, 30, 2) if tick not in (10, 12)]
    assert sum(stage.bench.refused(LEADER).values()) == 2
    assert last_words(stage).startswith("it has ended: 2 of 2 messages ")


def test_a_doubled_pull_is_refused_once_and_a_doubled_or_old_view_is_answered_once() -> None:
    doubled = led(lead_fault("duplicate", "from", for_s=0.004), lead_fault("duplicate", "to", 0.020, for_s=0.004))
    assert doubled.run(30) < PATIENCE_S
    assert pulled(doubled) == list(range(0, 30, 2))
    assert doubled.bench.refused(LEADER) == {Reason.DUPLICATE: 2}
    old = led(lead_fault("stale", "to", for_s=0.006, age_ticks=1))
    assert old.run(30) < PATIENCE_S
    assert pulled(old) == [tick for tick in range(0, 30, 2) if tick not in (12, 14)]


def test_a_leader_of_whom_nothing_comes_is_lost_and_pulls_no_more() -> None:
    stage = led(lead_fault("loss", "from", probability=1.0))
    assert stage.run(10 + 2 * LOST_AFTER) < PATIENCE_S
    (lost,) = stage.bench.reported("lost")
    assert (lost["agent"], lost["missed_ticks"], lost["then"]) == (LEADER, LOST_AFTER, "stops pulling")
    assert stage.bench.commands("a1")[-1] == 10 + 2 * LOST_AFTER - 0.5


def test_the_leaders_messages_bear_no_name_that_could_be_wrong() -> None:
    problem = lead_fault("wrong_arm", "to").problem()
    assert problem is not None
    assert problem[0] == "arm"


def test_a_scenario_may_have_faults_of_a_leader_that_it_has() -> None:
    loss = {"at_s": 1.0, "kind": "loss", "arm": "leader", "direction": "to"}
    assert load_scenario("transport", {"events": [loss]}).scenario.events[0].kind == "loss"
    stuck = {"at_s": 1.0, "kind": "joint_stuck", "arm": "leader", "joint": 1}
    wrong = loss | {"kind": "wrong_arm", "name": "a2"}
    nobody: dict[str, Any] = {"events": [loss], "leader": None, "expect": {}}
    for changes in ({"events": [stuck]}, {"events": [wrong]}, nobody):
        with pytest.raises(ScenarioError, match=r"events\.0\.arm"):
            load_scenario("transport", changes)


def test_in_real_time_a_late_pull_acts_as_late_as_told() -> None:
    bench = RealBench(leader=True)
    for name in ("a1", "a2"):
        bench.join(name, bench.answering_after(100_000))
    bench.join(LEADER, lambda agent, view: agent.force(view.tick, (float(view.tick), 0.0, 0.0)))
    bench.run(4)
    bench.clock.edge.begin(lead_fault("delay", "from", delay_ticks=1), 10)
    acted = []
    for tick in range(4, 14):
        bench.run(1)
        acted.append((tick, int(bench.forces()[-1][0])))
    assert acted == [(4, 2), (5, 4), (6, 4), (7, 6), (8, 6), (9, 8), (10, 10), (11, 10), (12, 12), (13, 12)]


leader_kinds = st.sampled_from(sorted(SETTINGS.keys() - {"wrong_arm"}))


@settings(max_examples=20, deadline=None)
@given(st.lists(leader_kinds, min_size=1, max_size=3), st.integers(0, 2**32), st.floats(0.1, 1.0))
def test_the_edge_knows_which_views_the_shipped_leader_answers(chain: list[str], seed: int, probability: float) -> None:
    simulator = PlayedSimulator("lock-step")
    link = simulator.broker.link()
    simulator.start(lambda: run_leader(link, LeaderSettings("test", (2.0, 0.0))))
    wait_for(simulator.view.matched)
    simulator.view.put(view_of(0))
    assert decode(simulator.answers.get(timeout=DEADLINE_S), LeaderForce).tick == 0
    edge = Edge(seed)
    for kind in chain:
        edge.begin(lead_fault(kind, "to", probability=probability), 40)
    for tick in range(1, 60):
        edge.settle(tick)
        out, answers = edge.send(LEADER, tick, 3, 0, view_of(tick) if tick % 3 == 0 else None)
        for payload in out:
            simulator.view.put(payload)
        answered = []
        while not simulator.answers.empty():
            answered.append(simulator.answers.get())
        assert answers == bool(answered)
        assert [edge.is_last(LEADER, each) for each in answered[-1:]] == [True] * answers
        assert not any(edge.is_last(LEADER, each) for each in answered[:-1])
    simulator.view.put(encode(End("over", "enough")))
    assert simulator.ended.get(timeout=DEADLINE_S) == "enough"


def view_of(tick: int) -> bytes:
    return encode(LeaderView(tick, tick * 10**6, (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3))


LEADER_FAULTS = {
    "events": [
        {"at_s": 0.005, "kind": "jitter", "arm": "leader", "direction": "to", "jitter_ticks": 5, "for_s": 0.06},
        {"at_s": 0.015, "kind": "bit_flip", "arm": "leader", "direction": "from", "probability": 0.7, "for_s": 0.07},
        {"at_s": 0.025, "kind": "loss", "arm": "leader", "direction": "to", "probability": 0.4},
    ]
}


def test_two_runs_with_faults_of_the_leaders_messages_leave_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        begin(tmp_path / name, LEADER_FAULTS)
    begin(tmp_path / "none", {})
    one, two, none = ((tmp_path / name / "trace.parquet").read_bytes() for name in ("one", "two", "none"))
    assert one == two != none
    run = read_json(tmp_path / "one" / "run.json")
    assert run["unproven"] == []
    assert run["agents"][LEADER]["missed_ticks"] > 0
    assert run["agents"] == read_json(tmp_path / "two" / "run.json")["agents"]


# In real time


def test_in_real_time_a_late_command_acts_as_late_as_told() -> None:
    bench = RealBench()
    for name in ("a1", "a2"):
        bench.join(name, bench.answering_after(100_000))
    bench.run(5)
    bench.clock.edge.begin(fault("delay", delay_ticks=2), 25)
    bench.run(30)
    # 23 comes just before 25, which is in time again, and 24 after it.
    assert bench.commands("a2") == [tick + 0.5 for tick in range(35) if tick != 24]
    assert bench.refused("a2") == {Reason.STALE: 1}
    assert bench.ages("a2") == {0: 15, 1: 1, 2: 19}
    assert bench.ages("a1") == {0: 35}


def test_in_real_time_lost_states_are_missed_ticks_and_lose_the_arm_by_its_own_rule() -> None:
    bench = RealBench()
    for name in ("a1", "a2"):
        bench.join(name)
    bench.run(5)
    bench.clock.edge.begin(fault("loss", "to", probability=1.0), None)
    bench.run(LOST_AFTER)
    assert bench.phase("a2") is Phase.LOST
    assert bench.phase("a1") is Phase.TICKING


def test_nothing_at_the_edge_is_looked_at_for_an_arm_without_faults() -> None:
    bench = Bench()
    bench.join("a1")
    bench.join("a2")
    bench.clock.edge.begin(fault("loss", probability=1.0), 5)
    bench.run(4)
    assert decode(a_command(3), Command).tick == 3
    assert bench.commands("a1") == [0.5, 1.5, 2.5, 3.5]
    bench.clock.edge.settle(5)
    assert bench.clock.edge.troubled == set()
