"""A whole run in one process: the shipped simulator, followers and leader over the link in memory.

The simulator, MuJoCo and all, runs on the caller's thread. Every agent has a thread on which it greets; its answers
are worked out on the simulator's, as over a transport that brings them there.
"""

from __future__ import annotations

import queue
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from agents.departure import Departure
from agents.follower import Follower, FollowerSettings, carry
from agents.leader import Aims, LeaderSettings, lead
from agents.session import AgentSession, RunEnded, here
from sim_server.run_folder import RunFolder
from sim_server.scenario import Leader, Scenario
from sim_server.scenario_files import NamedScenario
from sim_server.server import Server
from wire.keys import Keys
from wire.memory import Broker, MemoryLink, MemoryQuestion, key_matches
from wire.messages import Hello, LeaderView, State

RUN = "fuzz"
JOIN_S = 60.0
END_S = 60.0


class _Question(MemoryQuestion):
    """One whose reply somebody waits for."""

    def __init__(self, key: str, payload: bytes) -> None:
        super().__init__(key, payload)
        self.reply_came: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def reply(self, payload: bytes) -> None:
        super().reply(payload)
        self.reply_came.put(payload)


class _PatientLink(MemoryLink):
    """A link in memory whose queries wait for a reply that comes from another thread."""

    def query(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        self.check_open()
        question = _Question(key, payload)
        for _, expression, handler in tuple(self._broker.queryables):
            if key_matches(expression, key):
                handler(question)
        try:
            return question.reply_came.get(timeout=timeout_s)
        except queue.Empty:
            return None


@dataclass(slots=True)
class Agent:
    """One agent's thread, and what came of it."""

    name: str
    refused: Counter[str]
    """What it has refused, by reason."""
    body: Callable[[], None]
    thread: threading.Thread | None = None
    ended: str = ""
    """Why, in the simulator's words."""
    problem: str = "it has not ended"

    def start(self, link: MemoryLink) -> None:
        def run() -> None:
            try:
                self.body()
                self.problem = "it has left"
            except RunEnded as end:
                self.ended, self.problem = str(end), ""
            except Exception as error:  # whatever it is, it is what this is looking for
                self.problem = f"{type(error).__name__}: {error}"
            finally:
                link.close()

        self.thread = threading.Thread(target=run, name=self.name, daemon=True)
        self.thread.start()


@dataclass(frozen=True, slots=True)
class Ran:
    """What a run left besides its folder."""

    problem: str
    """Why it did not come to its end; empty if it did."""
    agents: tuple[Agent, ...]


def run_in_memory(named: NamedScenario, folder: Path, between: Callable[[Broker, Keys], None] | None = None) -> Ran:
    """Run a scenario to its end.

    Args:
        between: is called when the simulator is there and no agent is.
    """
    broker, keys = Broker(), Keys(RUN)
    own = broker.link()
    server = Server(own, named, RUN, RunFolder(folder))
    if between is not None:
        between(broker, keys)
    agents = []
    for arm in named.scenario.arms:
        link = _PatientLink(broker)
        agents.append(_follower(named.scenario, link, keys, arm))
        agents[-1].start(link)
    if named.scenario.leader is not None:
        link = _PatientLink(broker)
        agents.append(_leader(named.scenario.leader, link, keys))
        agents[-1].start(link)
    try:
        outcome = server.run()
        problem = "" if outcome.completed else outcome.why
    except Exception as error:  # whatever it is, it is what this is looking for
        problem = f"{type(error).__name__}: {error}"
        own.close()  # the agents hear that the simulator is gone
    for agent in agents:
        if agent.thread is not None:
            agent.thread.join(END_S)
    return Ran(problem, tuple(agents))


def _follower(scenario: Scenario, link: MemoryLink, keys: Keys, arm: str) -> Agent:
    team = scenario.team
    follower = Follower(
        FollowerSettings(RUN, arm, team.arm, team.controller, team.gains, team.handover_s, team.leave_s)
    )

    session = AgentSession(link, keys.arm(arm), keys.sim_alive, follower.hello(), State)

    def body() -> None:
        carry(session, follower, session.join(JOIN_S), Departure())

    return Agent(arm, session.refused, body)


def _leader(leader: Leader, link: MemoryLink, keys: Keys) -> Agent:
    settings = LeaderSettings(
        RUN, leader.goal_m, leader.force_max_N, leader.stiffness_N_m, leader.damping_Ns_m, leader.point
    )
    hello = Hello("leader", RUN, "leader", "", "", *here())
    session = AgentSession(link, keys.leader, keys.sim_alive, hello, LeaderView)

    def body() -> None:
        lead(session, settings, session.join(JOIN_S), Aims(settings, None))

    return Agent("leader", session.refused, body)
