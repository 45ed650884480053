"""Events of a scenario: checked in the file, ordered and seen at their tick, over the in-memory wire."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import pytest
from bench import LOST_AFTER, RUN, TIMEOUT_S, Bench, MemoryAgent, ask, silent
from hypothesis import given
from hypothesis import strategies as st

from sim_server import happenings, process_deeds
from sim_server.errors import ScenarioError
from sim_server.faults.event import Seen
from sim_server.faults.grasps import FailGrasp
from sim_server.faults.physical import PhysicalEvent
from sim_server.faults.processes import ProcessEvent, RestartStorm, SimKill, Verb
from sim_server.faults.pushes import Push
from sim_server.grasping import Closing
from sim_server.happenings import Arrivals, Happenings
from sim_server.newcomers import CannotCome
from sim_server.process_deeds import Undone
from sim_server.reception import LEADER
from sim_server.scenario_events import AnyEvent, Join, check_events
from sim_server.scenario_files import load_scenario
from sim_server.snapshot import pack, unpack
from sim_server.world_builder import NotBuilt
from wire.codec import decode, encode
from wire.errors import Reason
from wire.keys import Keys
from wire.lifecycle import Phase
from wire.messages import Deed, Done, Goodbye, Leaving, Order

RETREAT_TICKS = 4
"""Ticks that an agent answers in memory after it has said that it leaves."""

# The file


def push(**changes: Any) -> dict[str, Any]:
    """A push on the load, as a file has it."""
    given = {"at_s": 1.0, "kind": "push", "point": "front", "for_s": 2.0, "force_N": [50.0, 0.0, 0.0], **changes}
    return {key: value for key, value in given.items() if value is not None}


JOIN_A5 = {"at_s": 9.0, "kind": "join", "arm": "a5", "strut": 4}
SIM_KILL = {"at_s": 1.5, "kind": "sim_kill"}


def message(**changes: Any) -> dict[str, Any]:
    """A loss of commands, as a file has it."""
    return {"at_s": 1.0, "kind": "loss", "arm": "a1", "direction": "from", **changes}


@pytest.mark.parametrize(
    ("events", "key", "words"),
    [
        ([{"at_s": 1.0, "kind": "boom"}], "events.0.kind", ("no such kind", "fail_grasp")),
        ([{"at_s": 1.0}], "events.0.kind", ("kill",)),
        ([{"at_s": 1.0, "kind": "kill"}], "events.0.agent", ("missing",)),
        ([{"at_s": 1.0, "kind": "kill", "agent": "a9"}], "events.0.agent", ("a9", "a1, a2")),
        ([{"at_s": 1.0, "kind": "kill", "agent": "a1", "arm": "a1"}], "events.0.arm", ("unknown key", "agent")),
        ([{"at_s": 99.0, "kind": "kill", "agent": "a1"}], "events.0.at_s", ("99 s", "20 s")),
        ([{"at_s": -1.0, "kind": "kill", "agent": "a1"}], "events.0.at_s", ("greater than or equal to 0",)),
        ([{"at_s": 1.0, "kind": "fail_grasp", "arm": "leader"}], "events.0.arm", ("leader",)),
        ([{"at_s": 1.0, "kind": "fail_grasp", "arm": "a1", "for_s": 0.0}], "events.0.for_s", ("greater than 0",)),
        ([{"at_s": t, "kind": "kill", "agent": "a1"} for t in (2.0, 1.0)], "events.0.kind", ("a1 is gone",)),
        ([{"at_s": 1.0, "kind": "start", "agent": "a1"}], "events.0.kind", ("a1 is running",)),
        ([{"at_s": t, "kind": "fail_grasp", "arm": "a1"} for t in (1.0, 3.0)], "events.1.arm", ("before",)),
        ([push(point="middle")], "events.0.point", ("'centre_of_mass'", "'middle'")),
        ([push(force_N=[50.0, 0.0])], "events.0.force_N", ("too few numbers", "[50.0, 0.0]", "at least 3")),
        ([push(force_N=[50.0, 0.0, 0.0, 0.0])], "events.0.force_N", ("at most 3",)),
        ([push(force_N=[50.0, 0.0, float("nan")])], "events.0.force_N.2", ("finite", "nan")),
        ([push(force_N=[0.0, 0.0, 0.0])], "events.0.force_N", ("nothing pushes",)),
        ([push(at_s=20.0)], "events.0.at_s", ("20 s is not before the run's end at 20 s",)),
        ([push(for_s=19.0)], "events.0.for_s", ("ends at 20 s", "end at 20 s")),
        ([push(for_s=-2.0)], "events.0.for_s", ("greater than 0", "-2.0")),
        ([push(arm="a9", point=None)], "events.0.arm", ("no arm 'a9'", "a1, a2, a3, a4")),
        ([push(arm="leader", point=None)], "events.0.arm", ("no arm 'leader'",)),
        ([push(arm="a1")], "events.0.arm", ("both `arm` and `point`",)),
        ([push(point=None)], "events.0.arm", ("neither `arm` nor `point`",)),
        ([push(shape="soft")], "events.0.shape", ("'smooth'", "'soft'")),
        ([push(hold_s=1.0)], "events.0.hold_s", ("shape 'constant'", "shape 'abrupt'")),
        ([push(period_s=1.0, shape="abrupt")], "events.0.period_s", ("shape 'smooth'",)),
        ([push(agent="a1")], "events.0.agent", ("unknown key", "force_N")),
        ([message(arm="a9")], "events.0.arm", ("no arm 'a9'", "a1, a2, a3, a4")),
        ([message(direction="up")], "events.0.direction", ("'to' or 'from'",)),
        ([message(for_s=19.0)], "events.0.for_s", ("ends at 20 s", "leave it out")),
        ([message(probability=1.5)], "events.0.probability", ("less than or equal to 1",)),
        ([message(kind="delay", delay_ticks=0)], "events.0.delay_ticks", ("greater than or equal to 1",)),
        ([message(burst_ticks=3)], "events.0.burst_ticks", ("unknown key", "probability")),
        ([{"at_s": 1.0, "kind": "joint_stuck", "arm": "a1", "joint": 8}], "events.0.joint", ("equal to 7",)),
        ([{"at_s": 1.0, "kind": "sensor_bias", "arm": "a1"}], "events.0.position_rad", ("nothing is changed",)),
        (
            [{"at_s": 1.0, "kind": "sensor_frozen", "arm": "a1", "channel": "wrench", "joint": 2}],
            "events.0.joint",
            ("not a joint's",),
        ),
        ([{"at_s": 1.0, "kind": "floor_step", "arm": "a1", "height_mm": 0.0}], "events.0.height_mm", ("step up",)),
        ([{"at_s": 1.0, "kind": "added_mass", "arm": "a1"}], "events.0.arm", ("None",)),
        (
            [SIM_KILL, {"at_s": 1.2, "kind": "kill", "agent": "a1"}],
            "events.0.at_s",
            ("events.1", "at 1 s", "run again"),
        ),
        ([{"at_s": 0.5, "kind": "hang", "agent": "a1"}, SIM_KILL], "events.1.at_s", ("a1 is hung", "cannot greet")),
        (
            [{"at_s": 0.5, "kind": "disconnect", "agent": "a1"}, SIM_KILL],
            "events.1.at_s",
            ("a1 is cut off", "cannot greet"),
        ),
        (
            [
                {"at_s": 0.5, "kind": "kill", "agent": "a4"},
                {"at_s": 9.0, "kind": "join", "arm": "a5", "strut": 4},
                SIM_KILL,
            ],
            "events.2.kind",
            ("robots come",),
        ),
        ([{"at_s": 1.0, "kind": "slow", "agent": "a1", "share_percent": 0.0}], "events.0.share_percent", ("5",)),
        ([{"at_s": t, "kind": "grasp_slip", "arm": "a1"} for t in (1.0, 3.0)], "events.1.arm", ("before",)),
        ([{"at_s": 1.0, "kind": "join", "arm": "a5", "strut": 4, "agent": "a1"}], "events.0.agent", ("unknown key",)),
        ([{"at_s": 1.0, "kind": "join", "arm": "a5", "strut": 4}], "events.0.strut", ("4 is taken by a4",)),
        (
            [
                {"at_s": 1.0, "kind": "leave", "agent": "a4"},
                {"at_s": 9.0, "kind": "join", "arm": "a5", "strut": 4},
                {"at_s": 15.0, "kind": "join", "arm": "a6", "strut": 4},
            ],
            "events.2.strut",
            ("4 is taken by a5",),
        ),
        ([{"at_s": 1.0, "kind": "join", "arm": "a5", "strut": 4}] * 2, "events.0.strut", ("4 is taken by a4",)),
    ],
)
def test_an_event_that_cannot_be_is_refused_with_file_and_key(
    events: list[dict[str, Any]], key: str, words: tuple[str, ...]
) -> None:
    with pytest.raises(ScenarioError) as error:
        load_scenario("transport", {"events": events})
    assert (error.value.file, error.value.key) == ("transport.toml", key)
    for word in words:
        assert word in str(error.value)


verbs = st.sampled_from(["kill", "stop", "continue", "start", "leave", "hang"])


@given(st.lists(verbs, max_size=6))
def test_events_of_one_agent_are_taken_exactly_when_there_is_a_process_to_do_them_to(chain: list[Verb]) -> None:
    """A second account of the same rule: a process that is there and runs, is there and is stopped, or is not there."""
    there, stopped, leaves, replaceable, possible = True, False, False, False, True  # hung is stopped, to these rules
    for verb in chain:
        possible = (
            possible
            and {
                "kill": there,
                "stop": there and not stopped,
                "hang": there and not stopped,
                "continue": there and stopped,
                "leave": there and not stopped and not leaves,
                "start": not there or stopped or replaceable,
            }[verb]
        )
        there, leaves = verb != "kill", verb == "leave"  # one that leaves is there until it has gone, whenever that is
        stopped, replaceable = verb in ("stop", "hang"), verb in ("continue", "leave")
    events = [ProcessEvent(at_s=float(k), kind=verb, agent="a1") for k, verb in enumerate(chain)]
    if possible:
        check_events(events, ("a1",), False, 100.0)
    else:
        with pytest.raises(ValueError, match="events"):
            check_events(events, ("a1",), False, 100.0)


# The clock


class HandsBook:
    """What has become of hands since it was last looked at."""

    def __init__(self) -> None:
        self.opened: list[str] = []
        self.grasped: list[Closing] = []
        self.empty: set[str] = set()

    def holds(self, arm: str) -> bool:
        return arm not in self.empty


class NoNewcomers:
    """Nobody comes."""

    def advance(self) -> None:
        pass

    def check(self, strut: int, promised: Collection[int]) -> None:
        raise CannotCome(f"strut {strut + 1}: nobody comes")

    def know(self, arm: str) -> None:
        pass

    def next_name(self) -> str:
        raise NotImplementedError

    def prepare(self, arm: str, strut: int) -> None:
        raise NotImplementedError

    def is_ready(self, arm: str) -> bool:
        raise NotImplementedError

    def arrive(self, arm: str) -> float:
        raise NotImplementedError

    def cancel(self, arm: str, why: str) -> None:
        raise NotImplementedError


class PushesBook:
    """What has become of pushes since it was last looked at."""

    def __init__(self) -> None:
        self.news: list[Seen] = []


class DamageBook(PushesBook):
    """Likewise of physical faults."""

    def begin(self, event: PhysicalEvent, tick: int, end: int | None) -> None:
        self.news.append(Seen(event, f"from {tick} to {end}", proves=event.arm != "a1"))

    def finish(self) -> None:
        pass


class NoHands:
    """A plant's hands that only write down."""

    def __init__(self) -> None:
        self.hands = HandsBook()
        self.disturbances = PushesBook()
        self.damage = DamageBook()
        self.names = ["a1", "a2"]
        self.book: list[tuple[object, ...]] = []

    def push(self, event: Push) -> None:
        self.book.append(("push", event.arm or event.point))
        self.disturbances.news.append(Seen(event, "50 N act"))

    def loosen(self, arm: str, force_N: float) -> None:
        self.book.append(("loosen", arm, force_N))

    def slip(self, arm: str) -> None:
        self.book.append(("open", arm))
        self.hands.opened.append(arm)


class Stage:
    """A bench with events, and a launcher that does deeds to agents in memory."""

    def __init__(
        self,
        *events: AnyEvent,
        launcher: bool = True,
        newcomers: Arrivals | None = None,
        waits: bool = True,
        ticks: int = 10**6,
        timeout_s: float = TIMEOUT_S,
        leader: bool = False,
    ) -> None:
        self.bench = Bench(timeout_s=timeout_s, leader=leader)
        names = ("a1", "a2", LEADER) if leader else ("a1", "a2")
        self.agents: dict[str, MemoryAgent] = {name: self.bench.join(name) for name in names}
        self.hands = NoHands()
        keys = Keys(RUN)
        self.deeds: list[Deed] = []
        link = self.bench.broker.link()
        self.orders = link.publisher(keys.order)
        self.do: Callable[[Deed], str] = self.obey
        if launcher:
            link.subscribe(keys.deeds, self._asked)
        self.happenings = Happenings(
            events,
            self.bench.reception,
            self.bench.clock,
            self.hands,
            self.bench.broker.link().publisher(keys.deeds),
            self.bench._report,
            period_ms=1,
            start_s=1.0,
            newcomers=newcomers or NoNewcomers(),
            waits=waits,
            ticks=ticks,
        )
        self.tick = 0

    def _asked(self, payload: bytes) -> None:
        deed = decode(payload, Deed)
        self.deeds.append(deed)
        self.orders.put(encode(Done(deed.number, self.do(deed))))

    def obey(self, deed: Deed) -> str:
        agent = self.agents[deed.agent]
        if deed.verb in ("kill", "disconnect"):
            agent.link.close()
        elif deed.verb in ("stop", "hang"):
            agent.behave = silent
        elif deed.verb in ("start", "reconnect"):
            self.agents[deed.agent] = MemoryAgent(self.bench.broker, deed.agent, BEHAVES)
        elif deed.verb == "continue":
            agent.behave = BEHAVES
        else:
            ask(self.bench.broker, agent.keys.hello, Leaving(agent.name, agent.lease))
            agent.behave = leaves(agent.seen[-1].tick + RETREAT_TICKS)
        return ""

    def run(self, ticks: int) -> float:
        took = 0.0
        for _ in range(ticks):
            self.happenings.before(self.tick)
            took += self.bench.run(1)
            self.tick += 1
        return took

    def reported(self, kind: str) -> list[tuple[object, object]]:
        return [(each["event"], each["agent"]) for each in self.bench.reported(kind)]


def leaves(last: int) -> Any:
    """Answers up to the tick ``last`` and says goodbye instead of answering another."""

    def behave(agent: MemoryAgent, state: Any) -> None:
        if state.tick <= last:
            BEHAVES(agent, state)
            return
        ask(agent.broker, agent.keys.hello, Goodbye(agent.name, agent.lease))
        agent.link.close()

    return behave


def BEHAVES(agent: MemoryAgent, state: Any) -> None:
    agent.command(state.tick, state.tick + 0.5)


def event(tick: int, kind: Verb, agent: str = "a2") -> ProcessEvent:
    return ProcessEvent(at_s=tick / 1000, kind=kind, agent=agent)


def test_a_kill_loses_the_arm_before_its_very_tick_and_a_start_regains_it_before_its() -> None:
    stage = Stage(event(3, "kill"), event(6, "start"))
    assert stage.run(9) < TIMEOUT_S
    assert stage.bench.commands("a2") == [0.5, 1.5, 2.5, 6.5, 7.5, 8.5]
    assert stage.bench.commands("a1") == [tick + 0.5 for tick in range(9)]
    assert stage.reported("ordered") == stage.reported("seen") == [("kill", "a2"), ("start", "a2")]
    (lost,) = stage.bench.reported("lost")
    assert (lost["missed_ticks"], lost["why"]) == (0, "its sign of life is gone")
    assert stage.agents["a2"].lease == 2


def test_a_stopped_agent_is_lost_by_its_missed_ticks_and_costs_no_time() -> None:
    stage = Stage(event(2, "stop"))
    assert stage.run(2 + LOST_AFTER - 1) < TIMEOUT_S
    assert stage.bench.phase("a2") is Phase.TICKING
    assert stage.run(1) < TIMEOUT_S
    (lost,) = stage.bench.reported("lost")
    assert lost["missed_ticks"] == LOST_AFTER


def test_a_hung_agent_costs_one_timeout_and_is_lost_by_its_missed_ticks_with_its_sign_of_life_there() -> None:
    stage = Stage(event(2, "hang"))
    assert TIMEOUT_S <= stage.run(2 + LOST_AFTER) < 2 * TIMEOUT_S
    (lost,) = stage.bench.reported("lost")
    assert lost["missed_ticks"] == LOST_AFTER
    assert stage.bench.reception.agents["a2"].alive
    assert stage.happenings.proofs.missing() == []


def test_a_hung_agent_that_is_let_go_in_time_goes_on_and_is_waited_for_again() -> None:
    stage = Stage(event(2, "hang"), event(5, "continue"))
    stage.run(10)
    assert stage.bench.commands("a2") == [0.5, 1.5, *(tick + 0.5 for tick in range(5, 10))]
    assert stage.bench.reported("lost") == []


def test_an_agent_that_is_cut_off_is_lost_at_once_and_has_a_new_lease_when_its_link_is_there_again() -> None:
    stage = Stage(event(2, "disconnect"), event(5, "reconnect"))
    assert stage.run(10) < TIMEOUT_S
    (lost,) = stage.bench.reported("lost")
    assert (lost["agent"], lost["why"], lost["missed_ticks"]) == ("a2", "its sign of life is gone", 0)
    assert stage.reported("seen") == stage.reported("ordered") == [("disconnect", "a2"), ("reconnect", "a2")]
    assert stage.agents["a2"].lease == 2
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in range(10) if tick not in (2, 3, 4)]
    assert stage.happenings.proofs.missing() == []


def test_a_link_that_only_says_it_is_cut_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_deeds, "DEED_S", 0.05)
    stage = Stage(event(2, "disconnect"))
    stage.do = lambda deed: ""
    with pytest.raises(Undone, match="its sign of life is still there"):
        stage.run(3)


def test_a_restart_storm_is_its_kills_and_starts_each_seen() -> None:
    stage = Stage(RestartStorm(kind="restart_storm", at_s=0.002, agent="a2", times=3, every_s=0.004))
    stage.run(14)
    assert stage.reported("seen") == stage.reported("ordered") == [("kill", "a2"), ("start", "a2")] * 3
    down = (2, 3, 6, 7, 10, 11)
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in range(14) if tick not in down]
    assert stage.agents["a2"].lease == 4
    assert stage.happenings.proofs.missing() == []
    with pytest.raises(ValueError, match=r"events\.1\.kind: a2 is gone at 0\.003 s"):
        check_events(
            [
                RestartStorm(kind="restart_storm", at_s=0.002, agent="a2", times=3, every_s=0.004),
                event(3, "stop"),
            ],
            ("a1", "a2"),
            False,
            1.0,
        )


def test_a_simulator_asks_for_its_own_death_once_and_the_next_one_knows_that_it_has_had_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(process_deeds, "DEED_S", 0.05)
    kills = [SimKill(kind="sim_kill", at_s=at_s) for at_s in (0.002, 0.006)]
    first, second = Stage(*kills), Stage(*kills)
    first.do = lambda deed: ""
    saved = unpack(pack(first.happenings.state()))
    with pytest.raises(Undone, match=r"'sim_kill' of the simulator at 0\.002 s was not done: .* still there"):
        first.run(3)
    assert [(deed.verb, deed.agent) for deed in first.deeds] == [("kill", "sim")]
    second.do = lambda deed: ""
    second.happenings.restore(saved)
    second.happenings.survive(1, 0)
    assert second.run(6) < TIMEOUT_S
    assert second.deeds == []
    assert second.reported("seen") == [("sim_kill", "sim")]
    assert len(second.happenings.proofs.missing()) == 1
    with pytest.raises(Undone, match=r"0\.006 s"):
        second.run(1)


def test_the_transport_giving_a_stopped_agent_up_does_not_change_when_it_is_lost() -> None:
    """It does so after half a second of wall time: a trace must not depend on that."""
    stage = Stage(event(2, "stop"))
    stage.run(4)
    stage.agents["a2"].link.close()
    stage.run(LOST_AFTER - 3)
    assert stage.bench.phase("a2") is Phase.TICKING
    stage.run(1)
    assert stage.bench.phase("a2") is Phase.LOST


def test_an_agent_that_is_continued_in_time_goes_on_with_its_lease() -> None:
    stage = Stage(event(2, "stop"), event(2 + LOST_AFTER - 2, "continue"))
    stage.run(10)
    assert stage.bench.phase("a2") is Phase.TICKING
    assert stage.bench.reported("lost") == []
    assert stage.bench.commands("a2") == [0.5, 1.5, *(tick + 0.5 for tick in range(LOST_AFTER, 10))]


def test_an_agent_that_is_continued_too_late_commands_nothing_until_it_is_started_again() -> None:
    stage = Stage(event(1, "stop"), event(10, "continue"), event(15, "start"))
    old = stage.agents["a2"]
    stage.run(12)
    old.command(11, 99.0)
    stage.bench.settle()
    assert stage.bench.refused("a2") == {Reason.PHASE: 1}
    assert "worth nothing" in stage.bench.reported("seen")[-1]["effect"]
    stage.run(5)
    old.command(16, 99.0, lease=1)
    stage.bench.settle()
    # Nobody ended it here, so it hears the states of ticks 15 and 16 too and answers them with its old lease.
    assert stage.bench.refused("a2") == {Reason.PHASE: 1, Reason.LEASE: 3}
    assert stage.bench.commands("a2") == [0.5, 15.5, 16.5]


def test_a_stopped_agent_whose_place_another_takes_is_lost_first() -> None:
    stage = Stage(event(2, "stop"), event(4, "start"))

    def replace(deed: Deed) -> str:
        if deed.verb == "start":
            stage.agents["a2"].link.close()
        return stage.obey(deed)

    stage.do = replace
    stage.run(6)
    assert stage.agents["a2"].lease == 2
    assert stage.bench.commands("a2") == [0.5, 1.5, 4.5, 5.5]


def test_the_clock_stands_until_an_agent_has_said_that_it_leaves_and_goes_on_while_it_does() -> None:
    stage = Stage(event(2, "leave"))
    assert stage.run(2 + RETREAT_TICKS) < TIMEOUT_S
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in range(2 + RETREAT_TICKS)]
    assert stage.bench.reported("leaving") == [{"agent": "a2"}]
    assert stage.reported("ordered") == [("leave", "a2")]
    assert stage.reported("seen") == []
    assert stage.run(1) < TIMEOUT_S
    assert stage.bench.reported("left") == [{"agent": "a2"}]
    assert ("stay", "a2") in stage.bench.book, "it stands clear already: nothing is left to let down"
    stage.run(1)
    assert stage.reported("seen") == [("leave", "a2")]
    assert stage.bench.reported("seen")[0]["effect"] == "it said goodbye"
    assert stage.bench.reported("lost") == []


def test_an_agent_that_says_goodbye_at_once_is_let_down_by_its_driver() -> None:
    """The leader does, and whoever has no time, or was written in another language."""
    stage = Stage(event(2, "leave"))

    def quick(deed: Deed) -> str:
        agent = stage.agents["a2"]
        ask(stage.bench.broker, agent.keys.hello, Goodbye(agent.name, agent.lease))
        agent.link.close()
        return ""

    stage.do = quick
    stage.run(3)
    assert ("let_down", "a2") in stage.bench.book
    assert stage.reported("seen") == [("leave", "a2")]


@pytest.mark.parametrize("how", ["kill", "stop"])
def test_an_agent_that_is_killed_or_frozen_while_it_leaves_is_lost(how: Verb) -> None:
    stage = Stage(event(2, "leave"), event(4, how))
    assert stage.run(4 + LOST_AFTER + 1) < TIMEOUT_S
    (lost,) = stage.bench.reported("lost")
    assert lost["missed_ticks"] == (0 if how == "kill" else LOST_AFTER)
    assert ("lose", "a2") in stage.bench.book
    seen = {each["event"]: each["effect"] for each in stage.bench.reported("seen")}
    assert seen["leave"] == "it was lost before it had gone"


def test_an_agent_that_is_started_again_while_it_leaves_is_another() -> None:
    stage = Stage(event(2, "leave"), event(3, "start"))

    def replace(deed: Deed) -> str:
        if deed.verb == "start":
            stage.agents["a2"].link.close()
        return stage.obey(deed)

    stage.do = replace
    stage.run(12)
    assert stage.bench.phase("a2") is Phase.TICKING
    assert stage.bench.commands("a2") == [tick + 0.5 for tick in range(12)]
    seen = {each["event"]: each["effect"] for each in stage.bench.reported("seen")}
    assert seen["leave"] == "it was lost before it had gone"


def test_an_agent_that_dies_of_the_signal_is_lost_and_the_run_goes_on() -> None:
    stage = Stage(event(2, "leave"))

    def dies(deed: Deed) -> str:
        stage.agents["a2"].link.close()
        return ""

    stage.do = dies
    assert stage.run(5) < TIMEOUT_S
    assert stage.reported("seen") == [("leave", "a2")]
    assert [each["agent"] for each in stage.bench.reported("lost")] == ["a2"]


def test_one_that_neither_leaves_nor_says_so_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_deeds, "DEED_S", 0.05)
    stage = Stage(event(2, "leave"))
    stage.do = lambda deed: ""
    with pytest.raises(Undone, match=r"'leave' of a2 at .* neither said that it is leaving nor goodbye"):
        stage.run(3)


def test_a_run_that_is_gone_on_with_sees_the_end_of_a_leave_that_was_ordered_before() -> None:
    first = Stage(event(2, "leave"))
    first.run(4)
    second = Stage(event(2, "leave"))
    second.happenings.restore(unpack(pack(first.happenings.state())))
    again = second.agents["a2"]
    second.run(1)
    assert second.reported("ordered") == second.reported("seen") == []
    again.behave = leaves(0)
    second.run(2)
    assert second.reported("seen") == [("leave", "a2")]


def test_without_a_launcher_the_run_ends_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_deeds, "NOBODY_S", 0.05)
    stage = Stage(event(2, "kill"), launcher=False)
    with pytest.raises(Undone, match=r"'kill' of a2 at 0\.002 s.*palanquin run"):
        stage.run(3)
    assert stage.tick == 2


def test_a_deed_that_the_launcher_cannot_do_ends_the_run_with_its_words() -> None:
    stage = Stage(event(2, "kill"))
    stage.do = lambda deed: "its process has ended already"
    with pytest.raises(Undone, match="its process has ended already"):
        stage.run(3)


def test_a_deed_that_is_reported_but_not_seen_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_deeds, "DEED_S", 0.05)
    stage = Stage(event(2, "kill"))
    stage.do = lambda deed: ""
    with pytest.raises(Undone, match="sign of life is still there"):
        stage.run(3)


def test_a_failing_grasp_is_loose_and_then_opens_at_its_tick() -> None:
    stage = Stage(FailGrasp(at_s=0.002, kind="fail_grasp", arm="a1", for_s=0.003, force_N=5.0))
    stage.run(5)
    assert stage.hands.book == [("loosen", "a1", 5.0)]
    stage.run(1)
    assert stage.hands.book == [("loosen", "a1", 5.0), ("open", "a1")]
    stage.run(1)
    assert stage.bench.reported("hand_opened") == [{"agent": "a1"}]
    assert stage.reported("ordered") == [("fail_grasp", "a1")]
    assert stage.reported("seen") == [("fail_grasp", "a1")] * 2


def test_a_push_is_ordered_at_its_tick_and_seen_when_it_has_acted() -> None:
    event = Push(at_s=0.002, kind="push", arm="a1", for_s=0.003, force_N=(5.0, 0.0, 0.0))
    stage = Stage(event, Push(at_s=0.003, kind="push", point="front", for_s=0.003, torque_Nm=(0.0, 0.0, 1.0)))
    stage.run(2)
    assert stage.bench.reported("ordered") == []
    stage.run(1)
    assert stage.hands.book == [("push", "a1")]
    assert stage.bench.reported("ordered") == [{"event": "push", "agent": "a1"}]
    assert stage.bench.reported("seen") == []
    stage.run(2)
    assert stage.bench.reported("seen") == [
        {"event": "push", "agent": "a1", "effect": "50 N act"},
        {"event": "push", "point": "front", "effect": "50 N act"},
    ]


def test_a_push_on_a_robot_that_is_not_there_ends_the_run_with_that_reason() -> None:
    stage = Stage(Push(at_s=0.0, kind="push", arm="a3", for_s=0.003, force_N=(5.0, 0.0, 0.0)))
    with pytest.raises(Undone, match="event 'push' of a3 at 0 s was not done: its robot is not there"):
        stage.run(1)


class BrokenBuild(NoNewcomers):
    """Somebody may come, but there is never a world with it."""

    def __init__(self) -> None:
        self.cancelled: list[str] = []

    def check(self, strut: int, promised: Collection[int]) -> None:
        pass

    def next_name(self) -> str:
        return "a9"

    def prepare(self, arm: str, strut: int) -> None:
        pass

    def is_ready(self, arm: str) -> bool:
        return True

    def arrive(self, arm: str) -> float:
        raise NotBuilt("the world with a9 could not be built")

    def cancel(self, arm: str, why: str) -> None:
        self.cancelled.append(arm)


def test_a_robot_that_somebody_wants_and_that_cannot_come_is_refused_and_the_run_goes_on() -> None:
    stage = Stage()
    stage.orders.put(encode(Order("join", 7)))
    assert stage.run(5) < TIMEOUT_S
    (refused,) = stage.bench.reported("refused_order")
    assert (refused["strut"], refused["text"]) == (7, "strut 7: nobody comes")
    assert stage.bench.commands("a1") == [tick + 0.5 for tick in range(5)]


@pytest.mark.parametrize("launcher", ["starts it", "cannot start it"])
def test_a_robot_whose_world_or_process_cannot_be_made_does_not_end_a_run_that_did_not_foresee_it(
    launcher: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(happenings, "LEAD_S", 0.003)
    newcomers = BrokenBuild()
    stage = Stage(newcomers=newcomers)
    problem = "no process could be started" if launcher == "cannot start it" else ""
    stage.do = lambda deed: problem
    stage.orders.put(encode(Order("join", 4)))
    assert stage.run(8) < TIMEOUT_S
    (wanted,) = stage.bench.reported("wanted")
    (refused,) = stage.bench.reported("refused_order")
    assert (wanted["agent"], refused["agent"]) == ("a9", "a9")
    assert refused["text"] == (problem or "the world with a9 could not be built")
    assert newcomers.cancelled == ["a9"]
    assert stage.bench.commands("a1") == [tick + 0.5 for tick in range(8)]


def test_a_robot_that_the_scenario_foresees_and_that_cannot_come_ends_the_run_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(happenings, "LEAD_S", 0.001)
    stage = Stage(Join(at_s=0.003, kind="join", arm="a9", strut=4), newcomers=BrokenBuild())
    stage.do = lambda deed: ""
    with pytest.raises(Undone, match=r"event 'join' of a9 at 0\.003 s was not done: the world with a9 could not"):
        stage.run(5)
