"""The audit catches every way in which a key could reach two agents, and holds when none does. The final look; what
connections carried is in test_connections.py."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from processes import Started, free_port, read_events, read_json, run_to_end, settings, started, wait_until

from deploy.agents_told import leader_arguments
from sim_server.audit import Auditor
from sim_server.connections import OVERHEAD, Connections
from sim_server.scenario_files import load_scenario
from sim_server.tally import Tallies
from sim_server.wiretap import Carried
from wire.keys import Keys
from wire.link import Link
from wire.memory import Broker, MemoryLink
from wire.zenoh_link import open_client, open_server

RUN = "audited"
KEYS = Keys(RUN)
A1, A2 = KEYS.arm("a1"), KEYS.arm("a2")
AGENTS = {"a1": A1, "a2": A2, "leader": KEYS.leader}


class NothingCarried:
    """Nobody is connected, says the kernel: all that these tests are about is what sessions declared."""

    def connections(self) -> list[Carried]:
        return []


class Team:
    """A simulator's link with its auditor, and agents that behave."""

    def __init__(self, *, names_proven: bool = False) -> None:
        self.broker = Broker()
        connections = Connections(NothingCarried(), Tallies(), OVERHEAD["tcp"])
        self.auditor = Auditor(self.broker.link(), KEYS, AGENTS, connections, names_proven=names_proven)
        self.links = {name: self.join(name) for name in AGENTS}

    def join(self, name: str) -> Link:
        link = self.broker.link()
        link.publisher(AGENTS[name].command)
        link.subscribe(AGENTS[name].state, lambda payload: None)
        link.declare_alive(AGENTS[name].alive)
        return link

    def verdict(self) -> tuple[str, list[str]]:
        self.auditor.look()
        return self.auditor.judge(dict.fromkeys(AGENTS, 1))[:2]


def test_agents_that_hear_their_own_key_and_observers_that_hear_the_truth_hold() -> None:
    team = Team()
    team.broker.link().subscribe(KEYS.progress, lambda payload: None)
    verdict, why = team.verdict()
    assert verdict == "holds"
    assert why[0] == "in the final look, no key of an agent was heard by anybody else"


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        (A1.state, f"a2 listened to {A1.state}, which is a1's"),
        (A1.command, f"a2 listened to {A1.command}, which is a1's"),
        (KEYS.leader.state, f"a2 listened to {KEYS.leader.state}, which is leader's"),
        (f"{KEYS.root}/arm/*/state", f"a2 listened to {A1.state} (asked for {KEYS.root}/arm/*/state), which is a1's"),
        (f"{KEYS.root}/**", f"a2 listened to {A1.state} (asked for {KEYS.root}/**), which is a1's"),
        (KEYS.progress, f"a2 listened to {KEYS.progress}, which is for no agent"),
        (KEYS.order, f"a2 listened to {KEYS.order}, which is for no agent"),
        ("palanquin/whisper", "a2 listened to palanquin/whisper, where only another agent could speak"),
    ],
)
def test_an_agent_that_listens_to_what_is_not_its_own_is_named_with_the_key(expression: str, said: str) -> None:
    team = Team()
    team.links["a2"].subscribe(expression, lambda payload: None)
    verdict, why = team.verdict()
    assert verdict == "violated"
    assert said in why


def test_a_session_that_is_no_agent_but_hears_an_arm_is_a_violation() -> None:
    team = Team()
    team.broker.link().subscribe(A1.state, lambda payload: None)
    verdict, (why,) = team.verdict()
    assert verdict == "violated"
    assert why == f"a session that is no agent (from memory) listened to {A1.state}, which is a1's"


def test_one_session_that_speaks_for_two_agents_is_a_violation() -> None:
    team = Team()
    team.links["a2"].publisher(A1.command)
    verdict, why = team.verdict()
    assert verdict == "violated"
    assert "one session stands for a1 and a2: what one hears, the other hears" in why


def test_who_offers_to_answer_greetings_is_a_violation() -> None:
    team = Team()
    team.links["a2"].answer_queries(A1.hello, lambda question: None)
    assert team.verdict() == ("violated", [f"a2 offered to answer {A1.hello} in the simulator's place"])


def test_two_sessions_of_one_name_at_once_are_not_known_to_be_one_agent() -> None:
    team = Team()
    team.join("a1")
    assert team.verdict() == ("unknown", ["2 sessions went by the name a1 at the same time"])


def test_where_credentials_prove_the_name_two_sessions_of_it_are_one_agent() -> None:
    team = Team(names_proven=True)
    team.join("a1")
    assert team.verdict()[0] == "holds"


def test_one_instance_after_another_is_one_agent() -> None:
    team = Team()
    team.links["a1"].close()
    team.join("a1")
    assert team.verdict()[0] == "holds"


def test_an_agent_that_was_never_seen_makes_the_evidence_incomplete() -> None:
    team = Team()
    team.links["a1"].close()
    assert team.verdict() == ("unknown", ["a1 took part, but was never seen to hear its own key"])


def test_without_a_look_nothing_is_known() -> None:
    assert Team().auditor.judge({})[:2] == ("unknown", ["nobody looked"])


def test_a_look_that_does_not_come_back_is_given_up_and_makes_the_evidence_incomplete(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    team, never = Team(), threading.Event()
    monkeypatch.setattr(MemoryLink, "census", lambda *_: never.wait(10.0))
    team.auditor.look(timeout_s=0.05)
    assert team.auditor.hangs
    verdict, why, _ = team.auditor.judge({})
    assert (verdict, why) == ("unknown", ["the final look did not come back within 0.05 s"])
    never.set()


def test_where_the_kernel_does_not_tell_nothing_is_known_of_the_time_before_the_final_look() -> None:
    team = Team()
    team.auditor.connections = Connections(None, Tallies(), OVERHEAD["tcp"])
    assert team.verdict()[0] == "unknown"


# Zenoh's tables


@pytest.mark.system
def test_zenoh_tells_the_simulator_who_declared_what_and_tells_nobody_else() -> None:
    """Asked once, when everything has arrived: while declarations are on their way the question can hang Zenoh."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_server(endpoint) as server, open_client(endpoint) as first, open_client(endpoint) as second:
        arrived: set[str] = set()
        first.subscribe(A1.state, lambda payload: arrived.add("first hears"))
        first.publisher(A1.command)
        second.answer_queries(A1.hello, lambda question: arrived.add("second is asked"))
        second.subscribe(f"{KEYS.root}/**", lambda payload: arrived.add("second hears"))
        server.watch_alive(A1.alive, lambda alive: arrived.add("first lives"))
        first.declare_alive(A1.alive)
        publisher = server.publisher(A1.state)

        def all_arrived() -> bool:
            publisher.put(b"")
            server.query(A1.hello, b"", 0.1)
            return len(arrived) == 4

        wait_until(all_arrived, "every declaration to have arrived")
        census = server.census((A1.state, A2.state))
        assert census is not None
        assert sorted(
            (each.kind, each.expression, each.keys) for each in census.declared if each.kind != "publisher"
        ) == [
            ("queryable", A1.hello, ()),
            ("subscriber", f"{KEYS.root}/**", (A1.state, A2.state)),
            ("subscriber", A1.state, (A1.state,)),
            ("token", A1.alive, ()),
        ]
        assert len(census.addresses) == 2
        own = {address for address in census.addresses.values() if address.startswith("tcp/127.0.0.1:")}
        assert len(own) == 2
        # A client knows its own link and nothing of the tables of the simulator.
        theirs = second.census((A1.state,))
        assert theirs is None or not theirs.declared


# A real run


@dataclass
class Run:
    folder: Path
    cwd: Path


@pytest.fixture(scope="module")
def eavesdropped(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """An open simulator, two followers and a leader; a session that calls itself a2 listens to a1's state."""
    cwd = tmp_path_factory.mktemp("eavesdropped")
    endpoint, values = f"tcp/127.0.0.1:{free_port()}", {"duration_s": 1.5, "team.count": 2, "load.mass_kg": 8.0}
    scenario = load_scenario("transport").scenario
    with ExitStack() as stack:

        def start(*arguments: str | Path, name: str) -> Started:
            return stack.enter_context(started(*arguments, cwd=cwd, name=name))

        place = ("--open", "--run", RUN, "--listen", endpoint, "--out", cwd / "run")
        sim = start("sim", "transport", *place, *settings(values), name="sim")
        sim.wait_until(lambda: "waiting for" in sim.output.read_text(), "the simulator")
        heard: list[bytes] = []
        with open_client(endpoint) as ear:
            speaks = ear.publisher(A2.command)  # kept: a publisher that is dropped is undeclared
            ear.subscribe(A1.state, heard.append)
            agent = ("--run", RUN, "--connect", endpoint)
            for arm in ("a1", "a2"):
                start("follower", "--arm", arm, *agent, name=arm)
            start("leader", *agent, *leader_arguments(scenario), name="leader")
            sim.end()
            speaks.put(b"")
        assert len(heard) >= 1400, "the rule was not broken: nothing was heard"
        assert any(event["kind"] == "started" for event in read_events(cwd / "run"))
        yield Run(cwd / "run", cwd)


@pytest.mark.system
@pytest.mark.timeout(180)
def test_the_audit_of_a_real_run_catches_who_breaks_the_rule(eavesdropped: Run) -> None:
    ended = run_to_end("audit", eavesdropped.folder, cwd=eavesdropped.cwd)
    assert ended.returncode == 1
    assert f"a2 listened to {A1.state}, which is a1's" in ended.stdout
    assert "no key reached two agents: violated" in ended.stdout


@pytest.mark.system
@pytest.mark.timeout(180)
def test_the_counts_are_those_of_the_ticks(eavesdropped: Run) -> None:
    found = read_json(eavesdropped.folder / "audit.json")
    counts = {(row["key"], row["direction"]): row["messages"] for row in found["counts"]}
    for arm in (A1, A2):
        assert counts[arm.state, "to"] == counts[arm.command, "from"] == 1500
        assert counts[arm.hello, "from"] == counts[arm.hello, "to"] == counts[arm.alive, "from"] == 1
    assert counts[KEYS.leader.state, "to"] == counts[KEYS.leader.command, "from"] == 150
    assert all(row["bytes"] >= 80 * row["messages"] for row in found["counts"] if "/alive" not in row["key"])


@pytest.mark.system
@pytest.mark.timeout(180)
def test_a_run_from_before_audits_and_a_spoiled_file_are_one_sentence(eavesdropped: Run, tmp_path: Path) -> None:
    old = tmp_path / "old"
    shutil.copytree(eavesdropped.folder, old)
    (old / "audit.json").unlink()
    ended = run_to_end("audit", old, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "has no audit.json: this run was recorded before runs were audited" in line
    assert ended.returncode == 2
    (old / "audit.json").write_text(json.dumps({"verdict": "holds"}))
    ended = run_to_end("audit", old, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "is no audit: why, processes, counts missing" in line
    assert ended.returncode == 2
    found = read_json(eavesdropped.folder / "audit.json")
    (old / "audit.json").write_text(json.dumps({**found, "verdict": "fine"}))
    ended = run_to_end("audit", old, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "is no audit: verdict: got 'fine', expected holds or violated or unknown" in line
    assert ended.returncode == 2
    ended = run_to_end("audit", tmp_path, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "is no run folder" in line
    assert ended.returncode == 2
