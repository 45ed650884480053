"""A leader that dies stops pulling, and another, started by hand with the same credential, takes over."""

from __future__ import annotations

import signal
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from played_simulator import DEADLINE_S, PlayedSimulator, wait_for
from processes import (
    HUNG,
    UNKNOWN_CONNECTION,
    Started,
    free_port,
    not_violated,
    read_events,
    read_json,
    settings,
    started,
)

from agents.errors import NotWelcome
from agents.leader import LeaderSettings, run_leader
from deploy.credential_store import CredentialStore
from sim_server.trace import read_trace
from wire.codec import decode, encode
from wire.errors import Reason
from wire.keys import Keys
from wire.messages import End, LeaderForce, LeaderView, Message, Progress, Refusal, Welcome
from wire.zenoh_link import open_client

WELCOME = Welcome(7, "lock-step", 10_000_000, {"front": (0.8, 0.0, 0.7)}, 40.0, 0.0, (0.0,) * 7)
TAKEN = Refusal(Reason.TAKEN, "one instance at a time")
LOST = encode(End("lost", "20 ticks without an answer"))


def view(tick: int) -> bytes:
    return encode(LeaderView(tick, tick * 1_000_000, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3))


class Busy(PlayedSimulator):
    """A simulator with a leader, that gives the answers to greetings in this order; before each it says these things
    to the leader that is in."""

    def __init__(self, *greetings: tuple[Message, tuple[bytes, ...]]) -> None:
        self.left, self.greeted = list(greetings), 0
        super().__init__("lock-step", self._next)

    def _next(self) -> Any:
        reply, said = self.left.pop(0) if len(self.left) > 1 else self.left[0]
        for payload in said:
            self.view.put(payload)
        self.greeted += 1
        return reply

    def lead(self, wait_s: float) -> None:
        link = self.broker.link()
        self.start(lambda: run_leader(link, LeaderSettings("test", (2.0, 0.0), wait_s=wait_s)))


def test_who_stands_in_line_gets_in_when_the_place_is_free_and_answers_nothing_before() -> None:
    simulator = Busy((TAKEN, (view(10),)), (TAKEN, (view(20), LOST)), (WELCOME, ()))
    simulator.lead(wait_s=DEADLINE_S)
    wait_for(lambda: simulator.greeted == 3)
    simulator.view.put(view(30))
    force = decode(simulator.answers.get(timeout=DEADLINE_S), LeaderForce)
    assert (force.tick, force.lease) == (30, 7)


def test_the_end_of_the_one_before_is_not_the_end_of_the_one_that_greets_just_then() -> None:
    simulator = Busy((WELCOME, (LOST,)))
    simulator.lead(wait_s=0.0)
    wait_for(simulator.view.matched)
    simulator.view.put(view(30))
    assert decode(simulator.answers.get(timeout=DEADLINE_S), LeaderForce).tick == 30
    simulator.view.put(LOST)
    assert "gave this agent up" in str(simulator.ended.get(timeout=DEADLINE_S))


def test_without_patience_and_at_its_end_taken_is_the_answer() -> None:
    for wait_s in (0.0, 0.3):
        simulator = Busy((TAKEN, ()))
        simulator.lead(wait_s)
        ended = simulator.ended.get(timeout=DEADLINE_S)
        assert isinstance(ended, NotWelcome)
        assert "one instance at a time" in str(ended)


def test_the_end_of_the_run_ends_the_line() -> None:
    simulator = Busy((TAKEN, (encode(End("over", "the run is over")),)))
    simulator.lead(wait_s=DEADLINE_S)
    assert simulator.ended.get(timeout=DEADLINE_S) == "the run is over"


# Real processes

RUN = "heirs"
GOAL_M = (0.3, 0.0)


@dataclass
class Succession:
    """A run with three leaders: one that is killed, one that comes too early, one that takes over."""

    folder: Path
    early: tuple[int, str]
    heir: int

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [each for each in read_events(self.folder) if (each["kind"], each.get("agent")) == (kind, "leader")]


def succeed(cwd: Path, wait_s: float) -> Succession:
    """The heir is started when the place is free, or stands in line before."""
    store = CredentialStore.create(cwd / "team", ["a1", "a2"], days=1, hosts=[])
    endpoint, folder, news = f"tcp/127.0.0.1:{free_port()}", cwd / "run", list[bytes]()
    with ExitStack() as stack:

        def start(name: str, *arguments: str, who: str = "leader") -> Started:
            own = ("--run", RUN, "--connect", endpoint, "--credential", f"team/{who}")
            return stack.enter_context(started(*arguments, *own, cwd=cwd, name=name))

        def lead(name: str, wait_s: float = 0.0) -> Started:
            return start(name, "leader", "--goal-m", *map(str, GOAL_M), "--wait-s", str(wait_s))

        values = {"team.count": 2, "load.mass_kg": 8.0, "duration_s": 120.0, "leader.goal_m": GOAL_M}
        place = ("--listen", endpoint, "--credentials", "team/sim", "--run", RUN, "--out", folder)
        sim = stack.enter_context(started("sim", "transport", *place, *settings(values), cwd=cwd, name="sim"))
        for arm in ("a1", "a2"):
            start(arm, "follower", "--arm", arm, who=arm)
        run = Succession(folder, (0, ""), 0)
        first = lead("first")
        sim.wait_until(lambda: any(each["kind"] == "started" for each in read_events(folder)), "the first tick")
        with open_client(endpoint, store.credential("observer")) as observer:
            observer.subscribe(Keys(RUN).progress, news.append)
            early = lead("early")
            run.early = early.end(), early.errors.read_text()
            in_line = lead("heir", wait_s) if wait_s else None
            if in_line is not None:
                in_line.wait_until(lambda: "standing in line" in in_line.said(), "the heir to stand in line")
            first.process.kill()
            sim.wait_until(lambda: run.events("lost"), "the loss")
            heir = in_line or lead("heir")
            sim.wait_until(lambda: len(run.events("joined")) == 2, "the heir to be let in")
            sim.wait_until(lambda: decode(news[-1], Progress).goal_distance_m < 0.1, "the load to be at the goal")
        sim.process.send_signal(signal.SIGINT)
        assert sim.end() == 3  # it was stopped
        run.heir = heir.end()
    return run


@pytest.mark.system
@pytest.mark.timeout(240)
@pytest.mark.parametrize("wait_s", [0.0, 60.0], ids=["started-after-the-loss", "in-line-before"])
def test_a_dead_leaders_pull_ends_and_another_takes_over(tmp_path: Path, wait_s: float) -> None:
    run = succeed(tmp_path, wait_s)
    # While the first lives there is no second.
    status, said = run.early
    assert status == 2
    assert "a second greeting while the first instance is ticking, expected one instance at a time" in said
    # It dies, and its pull with it, at the same tick.
    (lost,) = run.events("lost")
    assert (lost["then"], lost["missed_ticks"]) == ("stops pulling", 0)
    first, second = run.events("joined")
    assert (first["lease"], second["lease"]) == (1, 2)
    trace = read_trace(run.folder / "trace.parquet")
    pull, tick = np.linalg.norm(trace["leader.force"], axis=1), trace["tick"]
    assert pull[tick < lost["tick"]].min() > 0.0
    leaderless = pull[(tick >= lost["tick"]) & (tick < second["tick"])]
    np.testing.assert_array_equal(leaderless, 0.0)
    # The heir looks at the next whole 10 ms, and brings the load to the goal.
    assert pull[tick >= second["tick"] + 10].max() > 0.0
    assert np.hypot(*(trace["load.position"][-1, :2] - GOAL_M)) < 0.1
    assert run.heir == 0
    not_violated(read_json(run.folder / "audit.json"), HUNG, UNKNOWN_CONNECTION)
