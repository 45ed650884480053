"""Events that really happen to processes: each kind is seen, the bytes repeat, nobody is left over."""

from __future__ import annotations

import signal
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from processes import free_port, launched, read_events, read_json, started, wait_until

from sim_server.trace import read_trace

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]

ROUNDS = 3
"""Kills and restarts of one agent; each costs a process start of a second or more."""

SCENARIO = """
extends = "transport"
description = "Two arms and a light table; everything happens to one of them and to the leader."
duration_s = 6.3
[team]
count = 2
leave_s = 0.1
[load]
mass_kg = 8.0
[record]
every_ticks = 1
"""
STORY: tuple[tuple[int, str, str], ...] = (
    *((50 + 100 * k, "kill", "a2") for k in range(ROUNDS)),
    *((100 + 100 * k, "start", "a2") for k in range(ROUNDS)),
    (400, "stop", "a2"),
    (410, "continue", "a2"),
    (450, "stop", "leader"),
    (500, "kill", "leader"),
    (550, "start", "leader"),
    (600, "stop", "a2"),
    (650, "continue", "a2"),
    (700, "start", "a2"),
    (800, "leave", "a2"),
)
"""Ticks, kinds, agents."""


def scenario_file(folder: Path, story: tuple[tuple[int, str, str], ...]) -> Path:
    events = "".join(
        f'[[events]]\nat_s = {tick / 1000}\nkind = "{kind}"\nagent = "{agent}"\n' for tick, kind, agent in story
    )
    path = folder / "story.toml"
    path.write_text(SCENARIO + events)
    return path


@dataclass
class Told:
    """What came of the story."""

    folder: Path
    status: int
    said: str
    left_over: list[str]
    held: list[tuple[int, int, int]]
    """Restarts of a2 so far, and the simulator's descriptors and threads at some moments after them."""

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [event for event in read_events(self.folder) if event["kind"] == kind]

    def lost_at(self) -> dict[int, dict[str, Any]]:
        return {event["tick"]: event for event in self.events("lost")}

    @property
    def trace(self) -> bytes:
        return (self.folder / "trace.parquet").read_bytes()


def tell(cwd: Path) -> Told:
    with launched(str(scenario_file(cwd, STORY)), cwd, {}) as run:
        run.command.wait_until(lambda: run.has("started"), "the start")
        sim = next(each for each in run.command.look().values() if "sim" in each.cmdline())
        held: list[tuple[int, int, int]] = []

        def ended() -> bool:
            run.command.look()  # whoever is restarted must be seen, to be missed afterwards
            starts = [event for event in run.events() if (event["kind"], event.get("event")) == ("seen", "start")]
            with suppress(psutil.NoSuchProcess):
                held.append((len(starts), sim.num_fds(), sim.num_threads()))
            return run.command.process.poll() is not None

        wait_until(ended, "the end")
        status = run.command.end()
        return Told(run.folder, status, run.command.said(), run.command.survivors(), held)


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Told:
    return tell(tmp_path_factory.mktemp("story"))


def test_every_event_is_ordered_and_seen_at_its_tick(told: Told) -> None:
    story = [(tick, kind, agent) for tick, kind, agent in sorted(STORY, key=lambda each: each[0])]
    ordered, seen = (
        [(each["tick"], each["event"], each["agent"]) for each in told.events(kind)] for kind in ("ordered", "seen")
    )
    assert ordered == story, told.said
    assert seen[:-1] == story[:-1], told.said
    tick, *leave = seen[-1]
    assert leave == ["leave", "a2"]  # whose end is seen when it has gone
    assert 5000 < tick < 6300
    assert told.status == 1  # two arms do not reach the goal by then, but the run reached its end


def test_a_killed_agent_is_lost_at_once_and_a_stopped_one_after_20_missed_ticks(told: Told) -> None:
    lost = told.lost_at()
    for k in range(ROUNDS):
        assert (lost[50 + 100 * k]["agent"], lost[50 + 100 * k]["missed_ticks"]) == ("a2", 0)
    assert (lost[619]["agent"], lost[619]["missed_ticks"]) == ("a2", 20)
    assert (lost[500]["agent"], lost[500]["then"]) == ("leader", "stops pulling")
    assert len(lost) == ROUNDS + 2


def test_a_restarted_agent_commands_its_arm_from_the_very_tick_of_its_start_without_a_bump(told: Told) -> None:
    trace = read_trace(told.folder / "trace.parquet")
    age, torque = trace["a2.age_ticks"], trace["a2.tau"]
    for tick in (100, 200, 300, 700):
        assert age[tick - 1] > 0
        np.testing.assert_array_equal(age[tick : tick + 50], 0)
        # It takes over from what the arm carries by measured torque: noise of 0.05 N m per joint, five deviations.
        assert np.abs(torque[tick] - torque[tick - 1]).max() < 0.25


def test_an_agent_that_is_continued_in_time_was_only_late(told: Told) -> None:
    age = read_trace(told.folder / "trace.parquet")["a2.age_ticks"]
    np.testing.assert_array_equal(age[400:410], np.arange(1, 11))
    np.testing.assert_array_equal(age[410:420], 0)


def test_leases_count_the_instances_and_a_goodbye_is_no_loss(told: Told) -> None:
    run = read_json(told.folder / "run.json")
    assert (run["agents"]["a2"]["lease"], run["agents"]["a2"]["phase"]) == (ROUNDS + 2, "left")
    assert run["agents"]["leader"]["lease"] == 2
    assert [event["tick"] for event in told.events("leaving")] == [800]
    assert [event["tick"] for event in told.events("hand_opened")] == [901]
    (seen,) = [event for event in told.events("seen") if event["event"] == "leave"]
    assert [event["tick"] for event in told.events("left")] == [seen["tick"] - 1]


def test_an_agent_that_leaves_answers_every_tick_until_its_goodbye_and_stands_a_metre_clear(told: Told) -> None:
    (left,) = told.events("left")
    trace = read_trace(told.folder / "trace.parquet")
    np.testing.assert_array_equal(trace["a2.age_ticks"][700 : left["tick"]], 0)
    assert trace["a2.age_ticks"][left["tick"]] == 1, "the goodbye took the place of an answer"
    moved = trace["a2.base"][-1] - trace["a2.base"][901]
    assert float(np.hypot(*moved[:2])) > 1.0
    assert (trace["a2.grip"][902:] == 0.0).all()
    log = sorted(told.folder.glob("logs/a2.*"), key=lambda path: path.stat().st_mtime)[-1]
    assert "a2: left in order" in log.read_text()


def test_every_instance_has_its_own_log_and_none_is_left_over(told: Told) -> None:
    logs = {path.name for path in (told.folder / "logs").iterdir()}
    again = {f"a2.{k}.log" for k in range(2, ROUNDS + 3)}
    assert logs == {"sim.log", "a1.log", "a2.log", "leader.log", "leader.2.log"} | again
    assert told.left_over == []


def test_rounds_of_kill_and_start_leave_nothing_in_the_simulator(told: Told) -> None:
    """The clock stands for a second or more in every start, so that each round is seen many times while a2 is away."""
    descriptors, threads = (
        [min(each[what] for each in told.held if each[0] == starts) for starts in range(ROUNDS)] for what in (1, 2)
    )
    assert descriptors == [descriptors[0]] * ROUNDS
    # One comes and goes, presumably Zenoh's for its blocking calls; one for every round would be ROUNDS - 1.
    assert threads[-1] - threads[0] < ROUNDS - 1


def test_the_same_story_is_the_same_bytes(told: Told, tmp_path: Path) -> None:
    assert tell(tmp_path).trace == told.trace


def test_agents_that_were_started_by_hand_have_nobody_to_kill_them(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, ((20, "kill", "a2"),))
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    agents: tuple[tuple[str, ...], ...] = (
        ("follower", "--arm", "a1"),
        ("follower", "--arm", "a2"),
        ("leader", "--goal-m", "2", "0"),
    )
    with ExitStack() as stack:
        sim = stack.enter_context(
            started(
                *("sim", path, "--open", "--run", "hand", "--listen", endpoint, "--out", tmp_path / "run"),
                cwd=tmp_path,
                name="sim",
            )
        )
        for k, agent in enumerate(agents):
            line = (*agent, "--run", "hand", "--connect", endpoint)
            stack.enter_context(started(*line, cwd=tmp_path, name=f"agent{k}"))
        assert sim.end() == 3
        assert "nobody is there to do it" in sim.output.read_text()
    run = read_json(tmp_path / "run" / "run.json")
    assert (run["ended"]["completed"], run["ended"]["ticks"]) == (False, 20)
    assert read_json(tmp_path / "run" / "metrics.json")["verdict"] == "unknown"


def test_a_run_with_a_stopped_agent_ends_on_ctrl_c_with_nobody_left(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, ((20, "stop", "a2"),))
    with launched(str(path), tmp_path, {"duration_s": 30.0}) as run:
        run.wait_until_carrying(0.1)
        run.command.process.send_signal(signal.SIGINT)
        run.command.end()
        run.wait_until_nobody_is_left()
