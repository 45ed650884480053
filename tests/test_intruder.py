"""The intruder's attempts against an open simulator: what they give there is measured, and what is closed even there.

That the same rows are closed behind access rules is worth something only if they do open what is open.
"""

from __future__ import annotations

import json
import signal
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from processes import (
    HUNG,
    UNKNOWN_CONNECTION,
    Started,
    free_port,
    not_violated,
    read_events,
    read_json,
    run_to_end,
    settings,
    started,
)

from deploy.agents_told import leader_arguments
from deploy.chaos.attempt import Got
from deploy.chaos.evidence import settle
from deploy.chaos.intruder import ATTEMPTS, Row
from deploy.chaos.target import merged
from deploy.landlock import abi
from sim_server.scenario_files import load_scenario

pytestmark = [pytest.mark.system, pytest.mark.timeout(400)]

RUN = "attacked"
VALUES = {"team.count": 2, "load.mass_kg": 8.0}
LONGER_THAN_ANY_ATTACK_S = 3600.0


@dataclass
class Attacked:
    folder: Path
    rows: dict[str, Row]

    def named(self, is_open: bool) -> set[str]:
        return {name for name, row in self.rows.items() if row.got.is_open is is_open}


def carry(cwd: Path, *, attack: bool, duration_s: float) -> Attacked:
    """An open simulator and its agents; beside the follower of a1, an intruder inside walls. A run that is attacked is
    stopped when the attack is over, so that it lasts as long as that does on any machine."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    agent = ("--run", RUN, "--connect", endpoint)
    rows: list[Row] = []
    with ExitStack() as stack:

        def start(*arguments: str | Path, name: str) -> Started:
            return stack.enter_context(started(*arguments, cwd=cwd, name=name))

        place = ("--open", "--run", RUN, "--listen", endpoint, "--out", cwd / "run")
        sim = start("sim", "transport", *place, *settings({**VALUES, "duration_s": duration_s}), name="sim")
        sim.wait_until(lambda: "waiting for" in sim.output.read_text(), "the simulator")
        followers = {arm: start("follower", "--arm", arm, *agent, name=arm) for arm in ("a1", "a2")}
        start("leader", *agent, *leader_arguments(load_scenario("transport").scenario), name="leader")
        if attack:
            sim.wait_until(lambda: any(event["kind"] == "started" for event in read_events(cwd / "run")), "the start")
            own = cwd / "own"
            own.mkdir()
            aim = ("--private", cwd / "run" / "events.jsonl", "--pid", str(followers["a2"].process.pid), "--walls")
            ended = run_to_end("chaos", "attack", "--arm", "a1", "--other", "a2", *agent, *aim, cwd=own)
            assert ended.returncode == 0, ended.stderr
            assert sim.process.poll() is None, "the run ended before the attack: nothing was attacked"
            sim.process.send_signal(signal.SIGTERM)
            rows = [
                Row(each.pop("name"), each.pop("way"), Got(**each))
                for each in map(json.loads, ended.stdout.splitlines())
            ]
        sim.end(200)
    (cwd / "run" / "logs").mkdir()
    for arm in ("a1", "a2"):
        (cwd / "run" / "logs" / f"{arm}.log").write_text((cwd / f"{arm}.err").read_text())
    settled = settle(rows, cwd / "run", RUN, "a1")
    return Attacked(cwd / "run", {row.name: row for row in settled})


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> Attacked:
    return carry(tmp_path_factory.mktemp("attacked"), attack=True, duration_s=LONGER_THAN_ANY_ATTACK_S)


def test_an_intruder_tries_at_least_forty_things_and_each_has_an_answer(attacked: Attacked) -> None:
    assert len(attacked.rows) == len(ATTEMPTS) >= 40
    assert attacked.named(True) | attacked.named(False) == {attempt.name for attempt in ATTEMPTS}


OPENS = {
    *("hear everything", "hear all of Palanquin", "hear the whole run", "hear another arm's state"),
    *("hear all arms' states", "hear another arm's commands", "hear the leader's view of the load"),
    *("hear the leader's force", "hear the truth", "ask who is alive"),
    *("watch whether another lives", "whisper on a key of one's own", "hear as a peer", "hear as a router"),
    *("log in without a credential", "greet as another on its key", "answer greetings for the simulator"),
    *("command another arm", "pull as the leader", "order as the operator", "tell another a false state"),
    *("tell another that all is over", "say goodbye for another"),
}
CLOSED_BY_THE_LIFE_CYCLE = {
    *("greet as another on one's own key", "greet as the leader on one's own key", "greet a second time"),
    *("say goodbye with a wrong lease", "command with a stale lease", "replay an old command", "flood"),
    *("command a tick to come", "send what is no message", "send what is too long"),
}
CLOSED_BY_HOW_IT_IS_BUILT = {
    "read the simulator's tables": "the simulator's session answers nobody but itself",
    "write the simulator's settings": "the simulator's session takes no settings from anybody",
    "gossip as a peer": "the simulator's session does not gossip",
    "gossip as a router": "the simulator's session does not gossip",
    "call for others on the network": "no session answers a call: all have scouting off",
    "log in as another": "a simulator that asks for no password does not open to one who brings a password",
    "forge another's sign of life": "the edge is told of a sign of life once, and the other's own is there",
}
CLOSED_BY_THE_WALLS = {"listen for others"}
"""It would meet nobody without walls either: the others are clients and connect to nobody else."""
HOST = {attempt.name for attempt in ATTEMPTS if attempt.way == "host"}


def test_an_open_system_gives_an_intruder_nearly_all_that_access_rules_are_for(attacked: Attacked) -> None:
    assert attacked.named(True) >= OPENS


def test_what_the_protocol_refuses_is_closed_on_an_open_system_too(attacked: Attacked) -> None:
    assert attacked.named(False) >= CLOSED_BY_THE_LIFE_CYCLE
    refused = read_json(attacked.folder / "run.json")["agents"]["a1"]["refused"]
    assert {"lease", "stale", "future", "malformed", "length"} <= set(refused)


@pytest.mark.parametrize(("name", "why"), CLOSED_BY_HOW_IT_IS_BUILT.items())
def test_what_no_session_of_ours_does_is_closed_on_an_open_system_too(attacked: Attacked, name: str, why: str) -> None:
    """So these rows prove nothing about the access rules."""
    assert attacked.rows[name].got.is_open is False, (attacked.rows[name].got.evidence, why)


@pytest.mark.skipif(abi() < 6, reason="this kernel's Landlock lacks a wall")
def test_inside_walls_nothing_of_the_host_is_open(attacked: Attacked) -> None:
    assert attacked.named(False) >= HOST | CLOSED_BY_THE_WALLS


def test_every_attempt_is_judged_above() -> None:
    judged = [*OPENS, *CLOSED_BY_THE_LIFE_CYCLE, *CLOSED_BY_HOW_IT_IS_BUILT, *CLOSED_BY_THE_WALLS, *HOST]
    assert sorted(judged) == sorted(attempt.name for attempt in ATTEMPTS)


def test_an_attack_that_only_costs_time_leaves_the_trace_as_it_was(attacked: Attacked, tmp_path: Path) -> None:
    ticks = read_json(attacked.folder / "run.json")["ended"]["ticks"]
    assert ticks > 1000
    alone = carry(tmp_path, attack=False, duration_s=ticks / 1000)
    assert (attacked.folder / "trace.parquet").read_bytes() == (alone.folder / "trace.parquet").read_bytes()


def test_the_audit_names_the_intruder(attacked: Attacked) -> None:
    """It has gone by then. A connection that carried more than any agent's own messages explain is a violation; one
    that carried less, because the run went on for long, cannot be told from an agent's, and the audit says so."""
    audit = read_json(attacked.folder / "audit.json")
    reasons = audit["why"]
    if audit["verdict"] == "unknown":
        not_violated(audit, HUNG, UNKNOWN_CONNECTION)
        assert [why for why in reasons if why.startswith(UNKNOWN_CONNECTION)], reasons
        return
    assert audit["verdict"] == "violated", reasons
    listened = [why for why in reasons if why.startswith("a session that is no agent") and " listened to " in why]
    carried = [why for why in reasons if why.startswith("a connection from ") and "to any one agent" in why]
    assert listened or carried, reasons


def test_a_credential_is_laid_over_a_session_and_takes_nothing_away() -> None:
    below: dict[str, Any] = {"connect": {"endpoints": ["x"]}, "transport": {"link": {"tx": 1}}}
    above: dict[str, Any] = {"transport": {"auth": {"usrpwd": {"user": "a1"}}}}
    assert merged(below, above) == {**below, "transport": {"link": {"tx": 1}, "auth": {"usrpwd": {"user": "a1"}}}}


@pytest.mark.system
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "cannot be read (No such file or directory)"),
        ("{", "not JSON"),
        ("[]", "got a list, expected a JSON object"),
    ],
)
def test_a_bad_overlay_is_one_sentence_and_status_2(tmp_path: Path, text: str | None, said: str) -> None:
    if text is not None:
        (tmp_path / "o.json").write_text(text)
    arguments = ("--arm", "a1", "--other", "a2", "--run", "x", "--connect", "tcp/127.0.0.1:1", "--overlay", "o.json")
    ended = run_to_end("chaos", "attack", *arguments, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "--overlay o.json: " in line
    assert said in line
    assert ended.returncode == 2
