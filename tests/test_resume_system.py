"""Real processes started by hand: the simulator is killed, started again, and its agents come back by themselves."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from processes import Started, free_port, read_events, read_json, run_to_end, settings, started, wait_until

from sim_server.checkpoint_file import last_checkpoint
from sim_server.trace import read_trace

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

RUN = "demo"
VALUES = {"duration_s": 2.5, "team.count": 2, "load.mass_kg": 8.0, "record.checkpoint_s": 0.25}
AGENTS = ("a1", "a2", "leader")


@contextmanager
def team(cwd: Path, address: str, name: str, *options: str) -> Iterator[dict[str, Started]]:
    """Two followers and a leader, with their credentials."""
    with ExitStack() as stack:
        agents = {}
        for agent in AGENTS:
            role = ("leader", "--goal-m", "2", "0") if agent == "leader" else ("follower", "--arm", agent)
            common = ("--run", RUN, "--connect", address, "--credential", str(cwd / "team" / agent), *options)
            agents[agent] = stack.enter_context(started(*role, *common, cwd=cwd, name=f"{name}-{agent}"))
        yield agents


def serve(cwd: Path, address: str, *what: str) -> tuple[str, ...]:
    return ("sim", *what, "--listen", address, "--credentials", str(cwd / "team" / "sim"))


def tick_of(folder: Path) -> int:
    """Of the last checkpoint; -1 before the first."""
    last = last_checkpoint(folder)
    return int(last.stem) if last else -1


@dataclass
class Killed:
    """A run whose simulator was killed and started again, and two copies of its folder from between."""

    cwd: Path
    folder: Path
    copy: Path
    spare: Path
    tick: int
    """Of the last checkpoint."""
    statuses: dict[str, int]
    pids: dict[str, int]


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Killed:
    cwd = tmp_path_factory.mktemp("killed")
    assert run_to_end("credentials", cwd / "team", "--arms", "2", cwd=cwd).returncode == 0
    folder, address = cwd / "run", f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        command = serve(cwd, address, "transport", "--run", RUN, "--out", str(folder), *settings(VALUES))
        sim = stack.enter_context(started(*command, cwd=cwd, name="sim"))
        agents = stack.enter_context(team(cwd, address, "first"))
        sim.wait_until(lambda: tick_of(folder) >= 750, "the checkpoint at 0.75 s")
        sim.process.send_signal(signal.SIGKILL)
        assert sim.end() == -signal.SIGKILL
        tick = tick_of(folder)
        copy, spare = (Path(shutil.copytree(folder, cwd / name)) for name in ("copy", "spare"))
        wait_until(lambda: all("is gone" in agent.said() for agent in agents.values()), "the agents to notice")
        command = serve(cwd, address, "--resume", str(folder))
        again = stack.enter_context(started(*command, cwd=cwd, name="again"))
        statuses = {"sim": again.end(), **{name: agent.end() for name, agent in agents.items()}}
        pids = {name: agent.process.pid for name, agent in agents.items()}
    return Killed(cwd, folder, copy, spare, tick, statuses, pids)


def test_agents_come_back_to_a_simulator_that_was_killed_and_the_run_ends_in_order(killed: Killed) -> None:
    assert killed.statuses == {"sim": 1, "a1": 0, "a2": 0, "leader": 0}  # 1: so short a run does not reach the goal
    run = read_json(killed.folder / "run.json")
    assert {name: agent["pid"] for name, agent in run["agents"].items()} == killed.pids
    assert {agent["lease"] for agent in run["agents"].values()} == {1002}
    assert [resumed["tick"] for resumed in run["resumed"]] == [killed.tick]
    assert run["ended"] == {"completed": True, "why": "reached its duration", "ticks": 2500}


def test_the_trace_is_whole_and_the_events_go_on(killed: Killed) -> None:
    np.testing.assert_array_equal(read_trace(killed.folder / "trace.parquet")["tick"], np.arange(0, 2500, 5))
    events = [event["kind"] for event in read_events(killed.folder) if not event.get("undone")]
    assert events == [*["joined"] * 3, "started", "resumed", *["joined"] * 3, "ended"]
    files = {path.name for path in killed.folder.iterdir()}
    assert files == {"run.json", "metrics.json", "audit.json", "trace.parquet", "events.jsonl"}


def test_the_audit_does_not_vouch_for_the_simulator_that_was_killed(killed: Killed) -> None:
    audit = read_json(killed.folder / "audit.json")
    assert audit["verdict"] == "unknown"
    assert any("was started again" in why for why in audit["why"])


def test_new_agents_leave_the_same_trace_as_those_that_came_back(killed: Killed) -> None:
    """The run repeats byte for byte from the checkpoint on, whatever the agents remember of the time before."""
    address = f"tcp/127.0.0.1:{free_port()}"
    command = serve(killed.cwd, address, "--resume", str(killed.copy))
    with started(*command, cwd=killed.cwd, name="copy") as sim, team(killed.cwd, address, "second") as agents:
        assert sim.end() == 1
        assert [agent.end() for agent in agents.values()] == [0, 0, 0]
    assert (killed.copy / "trace.parquet").read_bytes() == (killed.folder / "trace.parquet").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--resume", "run"), "has ended in order"),
        (("--resume", "nowhere"), "no such folder"),
        ((), "which scenario?"),
    ],
)
def test_what_cannot_be_resumed_is_said_in_one_sentence(killed: Killed, arguments: tuple[str, ...], said: str) -> None:
    ended = run_to_end("sim", *arguments, "--open", "--listen", f"tcp/127.0.0.1:{free_port()}", cwd=killed.cwd)
    (line,) = ended.stderr.splitlines()
    assert said in line
    assert ended.returncode == 2


def test_wrong_credentials_change_nothing_in_the_folder(killed: Killed) -> None:
    before = {path: path.read_bytes() for path in killed.spare.rglob("*") if path.is_file()}
    address = f"tcp/127.0.0.1:{free_port()}"
    for credentials, said in (("team/a1", "a1"), ("nowhere", "nowhere")):
        command = ("sim", "--resume", killed.spare, "--listen", address, "--credentials", credentials)
        ended = run_to_end(*command, cwd=killed.cwd)
        (line,) = ended.stderr.splitlines()
        assert said in line
        assert ended.returncode == 2
    assert {path: path.read_bytes() for path in killed.spare.rglob("*") if path.is_file()} == before


def test_an_agent_that_was_leaving_as_the_simulator_died_leaves_the_one_that_goes_on(tmp_path: Path) -> None:
    address, folder = f"tcp/127.0.0.1:{free_port()}", tmp_path / "run"
    values = {"duration_s": 60.0, "team.count": 2, "load.mass_kg": 8.0, "record.checkpoint_s": 0.2}
    connect = ("--run", RUN, "--connect", address)
    serve = ("--open", "--listen", address)

    def events(kind: str) -> list[dict[str, object]]:
        return [each for each in read_events(folder) if each["kind"] == kind and not each.get("undone")]

    with ExitStack() as stack:
        begin = ("sim", "hold", *serve, "--run", RUN, "--out", str(folder), *settings(values))
        sim = stack.enter_context(started(*begin, cwd=tmp_path, name="sim"))
        a1, a2 = (
            stack.enter_context(started("follower", "--arm", arm, *connect, "--leave-s", "0.1", cwd=tmp_path, name=arm))
            for arm in ("a1", "a2")
        )
        sim.wait_until(lambda: tick_of(folder) >= 0, "the first checkpoint")
        a2.process.send_signal(signal.SIGTERM)
        sim.wait_until(lambda: events("hand_opened"), "the hand to open")
        opened = events("hand_opened")[0]["tick"]
        assert isinstance(opened, int)
        sim.wait_until(lambda: tick_of(folder) > opened, "a checkpoint after that")
        sim.process.send_signal(signal.SIGKILL)
        sim.end()
        wait_until(lambda: all("is gone" in agent.said() for agent in (a1, a2)), "the agents to notice")
        again = stack.enter_context(started("sim", "--resume", folder, *serve, cwd=tmp_path, name="again"))
        again.wait_until(lambda: events("left"), "the goodbye")
        assert a2.end() == 0
        assert "a2: left in order" in a2.said()
        again.process.send_signal(signal.SIGINT)
        again.end()
        assert a1.end() == 0
    trace = read_trace(folder / "trace.parquet")
    assert [each["agent"] for each in events("leaving")] == ["a2", "a2"], "it tells the next simulator as well"
    assert (trace["a2.grip"][trace["tick"] > opened + 1] == 0.0).all(), "its hand stayed open"
    assert events("lost") == []


def test_agents_end_when_the_simulator_does_not_come_back_in_the_time_they_were_given(tmp_path: Path) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    serve = ("sim", "transport-one", "--open", "--run", RUN, "--listen", address, "--out", str(tmp_path / "run"))
    connect = ("--run", RUN, "--connect", address)
    with ExitStack() as stack:
        sim = stack.enter_context(started(*serve, cwd=tmp_path, name="sim"))
        patient = ("follower", "--arm", "a1", *connect, "--reconnect-s", "0.3")
        follower = stack.enter_context(started(*patient, cwd=tmp_path, name="follower"))
        at_once = ("leader", "--goal-m", "1", "0", *connect, "--reconnect-s", "0")
        leader = stack.enter_context(started(*at_once, cwd=tmp_path, name="leader"))
        sim.wait_until(lambda: tick_of(tmp_path / "run") >= 0, "the first checkpoint")
        sim.process.send_signal(signal.SIGKILL)
        assert follower.end() == 3
        assert "has not come back within 0.3 s" in follower.said().splitlines()[-1]
        assert leader.end() == 3
        assert leader.said().splitlines()[-1].endswith("leader: the simulator is gone")
        wait_until(lambda: sim.process.poll() is not None, "the simulator to be gone")
    ended = run_to_end("metrics", tmp_path / "run", cwd=tmp_path)
    assert ended.returncode == 2
    assert "palanquin sim --resume" in ended.stderr
