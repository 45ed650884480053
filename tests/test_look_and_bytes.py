"""Real runs: who listened for a while is caught by the bytes, honest runs hold, nobody can hang the simulator."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh
from processes import (
    HUNG,
    UNKNOWN_CONNECTION,
    Started,
    free_port,
    launched,
    not_violated,
    read_events,
    read_json,
    run_to_end,
    settings,
    started,
)

from agents.follower import FollowerSettings, run_follower
from deploy.agents_told import leader_arguments
from sim_server.scenario_files import load_scenario
from wire.errors import LinkError
from wire.keys import Keys
from wire.zenoh_link import ZenohLink, open_client

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

RUN = "listened"
KEYS = Keys(RUN)
TEAM = {"team.count": 2, "load.mass_kg": 8.0}


@dataclass
class OpenRun:
    """An open simulator whose a2 lives in this process, where a test can make it misbehave."""

    folder: Path
    audit: dict[str, Any]
    status: int


def carry(cwd: Path, duration_s: float, misbehave: Callable[[ZenohLink, str], None]) -> OpenRun:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    agent = ("--run", RUN, "--connect", endpoint)
    folder = cwd / "run"
    with ExitStack() as stack:

        def start(*arguments: str | Path, name: str) -> Started:
            return stack.enter_context(started(*arguments, cwd=cwd, name=name))

        place = ("--open", "--run", RUN, "--listen", endpoint, "--out", folder)
        sim = start("sim", "transport", *place, *settings({**TEAM, "duration_s": duration_s}), name="sim")
        sim.wait_until(lambda: "waiting for" in sim.output.read_text(), "the simulator")
        start("follower", "--arm", "a1", *agent, name="a1")
        start("leader", *agent, *leader_arguments(load_scenario("transport").scenario), name="leader")
        link = stack.enter_context(open_client(endpoint))

        def follow() -> None:
            with suppress(Exception):  # the end of an agent whose simulator is gone is its own matter
                run_follower(link, FollowerSettings(RUN, "a2", "panda", "paper", {}, 1.0))

        a2 = threading.Thread(target=follow, daemon=True)
        a2.start()
        sim.wait_until(lambda: any(event["kind"] == "started" for event in read_events(folder)), "the start")
        misbehave(link, endpoint)
        status = sim.end()
        a2.join(10.0)
    return OpenRun(folder, read_json(folder / "audit.json"), status)


def test_who_listened_in_the_middle_of_the_run_and_went_quiet_is_caught_by_the_bytes_alone(tmp_path: Path) -> None:
    heard: list[bytes] = []

    def listen(link: ZenohLink, endpoint: str) -> None:
        before = len(link._declared)
        link.subscribe(KEYS.arm("a1").state, heard.append)
        while len(heard) < 300:
            time.sleep(0.001)
        link._declared.pop(before).undeclare()

    run = carry(tmp_path, 3.0, listen)
    assert 300 <= len(heard) < 2500, "it was to listen for a part of the run"
    states = {key for session in run.audit["sessions"].values() for key in session["heard"]}
    assert KEYS.arm("a2").state in states
    assert {tuple(session["heard"]) for session in run.audit["sessions"].values() if session["agents"] == ["a2"]} == {
        (KEYS.arm("a2").state,)
    }, "the final look sees nothing of it"
    assert run.audit["verdict"] == "violated"
    (why,) = run.audit["why"]
    assert why.startswith("the connection of a2 (from 127.0.0.1:")
    assert "and the messages meant for it explain at most" in why


def test_an_open_run_of_those_who_behave_holds(tmp_path: Path) -> None:
    run = carry(tmp_path, 1.0, lambda link, endpoint: None)
    assert run.audit["verdict"] == "holds", run.audit["why"]
    assert {each["agent"] for each in run.audit["connections"]} == {"a1", "a2", "leader"}


def test_those_who_come_declare_and_go_without_a_pause_cannot_hang_the_simulator(tmp_path: Path) -> None:
    """Nor those who ask for its tables: with a look every second, this hung it within a few looks."""
    over, went = threading.Event(), [0] * 3

    def disturb(link: ZenohLink, endpoint: str) -> None:
        def come_and_go(number: int) -> None:
            while not over.is_set():
                with suppress(LinkError, zenoh.ZError), open_client(endpoint, timeout_s=0.5) as client:
                    client.subscribe(f"churn/{number}/s", lambda payload: None)
                    client.publisher(f"churn/{number}/c")
                    client.declare_alive(f"churn/{number}/alive")
                    client.watch_alive(KEYS.sim_alive, lambda alive: None)
                    client.query("@/**", b"", 0.05)
                    went[number] += 1

        for number in range(len(went)):
            threading.Thread(target=come_and_go, args=(number,), daemon=True).start()

    try:
        run = carry(tmp_path, 2.0, disturb)
    finally:
        over.set()
    assert sum(went) > 20, "nobody disturbed it"
    assert run.status == 1  # two seconds do not reach the goal
    assert read_json(run.folder / "run.json")["ended"]["completed"]
    assert (run.folder / "metrics.json").exists()
    not_violated(run.audit, HUNG, UNKNOWN_CONNECTION)
    assert not list(run.folder.glob("*.part"))


@pytest.mark.parametrize(
    ("scenario", "values"),
    [("hold", {**TEAM, "duration_s": 0.2}), ("transport-six", {"duration_s": 0.5})],
)
def test_an_honest_run_holds(scenario: str, values: dict[str, float], tmp_path: Path) -> None:
    """Two arms and six; a run of four is audited in test_system."""
    with launched(scenario, tmp_path, values) as run:
        run.command.end()
    ended = run_to_end("audit", run.folder, cwd=tmp_path)
    assert "no key reached two agents: holds" in ended.stdout, ended.stdout
    assert ended.returncode == 0


def test_a_run_with_a_killed_follower_holds(tmp_path: Path) -> None:
    with launched("transport", tmp_path, {**TEAM, "duration_s": 2.5}) as run:
        run.wait_until_carrying(0.6)
        run.signal("a2", signal.SIGKILL)
        run.command.end()
    audit = read_json(run.folder / "audit.json")
    assert audit["verdict"] == "holds", audit["why"]
    (gone,) = [each for each in audit["connections"] if each["known"] != "final look"]
    assert gone["agent"] == "a2"


HANGS = """
import sys, time
if "sim" in sys.orig_argv:
    from wire.zenoh_link import ZenohLink
    ZenohLink.census = ZenohLink.close = lambda *_: time.sleep(1000)
"""


def test_a_final_look_that_never_comes_back_costs_two_seconds_and_the_audits_verdict_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when Zenoh hangs: neither the look nor closing the session ever returns."""
    (tmp_path / "sitecustomize.py").write_text(HANGS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with launched("hold", tmp_path, {**TEAM, "duration_s": 0.3}) as run:
        assert run.command.end() == 0
        assert not run.command.survivors()
    audit = read_json(run.folder / "audit.json")
    assert (audit["verdict"], audit["final_look_came_back"]) == ("unknown", False)
    assert "the final look did not come back within 2 s" in audit["why"]
    assert read_json(run.folder / "metrics.json")["verdict"] == "holds"
    assert "holds: reached its duration" in (run.folder / "logs" / "sim.log").read_text()
    assert "the simulator is gone" in (run.folder / "logs" / "a1.log").read_text()
