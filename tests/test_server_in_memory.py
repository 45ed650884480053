"""The whole server, MuJoCo and real followers in one process: its ticks, its folder, and one trace per seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from bench import RUN, MemoryAgent
from processes import read_events, read_json

from agents.follower import Follower, FollowerSettings
from agents.leader import LeaderSettings, pull
from sim_server.reception import LEADER
from sim_server.run_folder import RunFolder
from sim_server.scenario_files import load_scenario
from sim_server.server import Outcome, Server
from wire.codec import decode, encode
from wire.memory import Broker
from wire.messages import LeaderView, State, Welcome

# The whole server, MuJoCo and real followers in one process


def server_run(folder: Path, seed: int, ticks: int, arms: int = 1) -> tuple[Outcome, list[MemoryAgent]]:
    """A run of `transport-one` or `transport` whose followers answer inside the publication of their state."""
    name = "transport-one" if arms == 1 else "transport"
    named = load_scenario(name, {"seed": seed, "duration_s": ticks / 1000, "record": {"every_ticks": 1}})
    broker = Broker()
    server = Server(broker.link(), named, RUN, RunFolder(folder))
    agents = []
    for arm in named.scenario.arms:
        follower = Follower(FollowerSettings(RUN, arm, "panda", "paper", {}))

        def answer(agent: MemoryAgent, state: State | LeaderView, follower: Follower = follower) -> None:
            assert isinstance(state, State)
            follower.check(state)
            agent.publisher.put(encode(follower.answer(state, agent.lease, 1e-3)))

        agents.append(MemoryAgent(broker, arm, answer, follower.hello()))
    assert named.scenario.leader is not None
    wanted = LeaderSettings(RUN, named.scenario.leader.goal_m, named.scenario.leader.force_max_N)

    def lead(agent: MemoryAgent, view: State | LeaderView) -> None:
        assert isinstance(view, LeaderView)
        point = decode(agent.greeting.replies[0], Welcome).points["front"]
        agent.force(view.tick, tuple(pull(view, np.array(point), wanted).tolist()))

    agents.append(MemoryAgent(broker, LEADER, lead))
    return server.run(), agents


def test_the_whole_server_runs_its_ticks_leaves_its_folder_and_sends_everybody_home(tmp_path: Path) -> None:
    outcome, agents = server_run(tmp_path / "run", 1, 30)
    assert (outcome.completed, outcome.why) == (True, "reached its duration")
    events = read_events(tmp_path / "run")
    assert [event["kind"] for event in events] == ["joined", "joined", "started", "ended"]
    assert [(event["tick"], event["time_s"]) for event in events] == [(0, 0.0)] * 3 + [(30, 0.03)]
    run = read_json(tmp_path / "run" / "run.json")
    assert run["ended"] == {"completed": True, "why": "reached its duration", "ticks": 30}
    assert run["measured"]["refused_messages"] == 0
    follower, leader = agents
    assert [state.tick for state in follower.seen] == list(range(30))
    assert [view.tick for view in leader.seen] == [0, 10, 20]
    assert {agent.ended for agent in agents} == {"the run is over"}


def test_one_seed_is_one_trace_and_another_seed_another(tmp_path: Path) -> None:
    for folder, seed in (("first", 1), ("again", 1), ("other", 2)):
        server_run(tmp_path / folder, seed, 40, arms=4)
    first, again, other = ((tmp_path / folder / "trace.parquet").read_bytes() for folder in ("first", "again", "other"))
    assert first == again
    assert first != other
