"""Faults on real processes over real Zenoh: what is told of them is what the trace shows, and they repeat."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import launched, read_events, read_json

from deploy.hanging import control_threads, is_hung
from sim_server.trace import read_trace

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]

TICKS, HUNG_AT = 500, 400
SCENARIO = """
extends = "hold"
description = "Several message faults at once."
duration_s = 0.5
[team]
count = 2
[load]
mass_kg = 8.0
[record]
every_ticks = 1
[clock]
answer_timeout_s = 2.0
"""
MESSAGES = """
[[events]]
at_s = 0.05
kind = "loss"
arm = "a1"
direction = "from"
for_s = 0.3
[[events]]
at_s = 0.1
kind = "truncate"
arm = "a2"
direction = "to"
for_s = 0.2
probability = 0.1
[[events]]
at_s = 0.1
kind = "duplicate"
arm = "a2"
direction = "from"
"""
PROCESSES = f"""
[[events]]
at_s = 0.15
kind = "slow"
agent = "a2"
share_percent = 30.0
[[events]]
at_s = 0.25
kind = "continue"
agent = "a2"
[[events]]
at_s = {HUNG_AT / 1000}
kind = "hang"
agent = "a1"
"""


def tell(cwd: Path, events: str, hangs: bool) -> tuple[Path, int]:
    path = cwd / "story.toml"
    path.write_text(SCENARIO + events)
    with launched(str(path), cwd, {}) as run:
        if hangs:
            run.command.wait_until(lambda: run.has("seen", event="hang"), "the hang")
            pid = next(each["pid"] for each in run.events() if each["kind"] == "joined" and each["agent"] == "a1")
            assert is_hung(pid)
            assert control_threads(pid) != [pid], "in lock-step it is not the first thread"
        status = run.command.end()
        run.command.look()
        assert run.command.survivors() == []
    return run.folder, status


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tell(tmp_path_factory.mktemp("all"), MESSAGES + PROCESSES, hangs=True)[0]


def last_words(folder: Path) -> dict[str, str]:
    return {each["event"]: each["effect"] for each in read_events(folder) if each["kind"] == "seen"}


def numbers(effect: str) -> list[int]:
    return [int(each) for each in re.findall(r"\d+", effect)]


def ages(folder: Path, arm: str, until: int) -> Any:
    return read_trace(folder / "trace.parquet")[f"{arm}.age_ticks"][:until]


def test_what_is_counted_of_message_faults_is_what_the_trace_and_the_refusals_show(told: Path) -> None:
    effects = last_words(told)
    lost, cut = numbers(effects["loss"]), numbers(effects["truncate"])
    assert lost[:2] == [np.count_nonzero(ages(told, "a1", HUNG_AT)), 300]
    assert 15 < lost[0] < 45  # 30 with a deviation of 5
    assert cut == [np.count_nonzero(ages(told, "a2", TICKS)), 200, cut[0]]
    assert effects["truncate"].endswith(f"{cut[0]} refused as malformed")
    log = (told / "logs" / "a2.log").read_text()
    assert "refused a message of the simulator: malformed" in log
    doubled = numbers(effects["duplicate"])
    assert doubled == [TICKS - 100 - cut[0]] * 2, "each answer from the 100th tick on"
    assert read_json(told / "run.json")["agents"]["a2"]["refused"] == {"duplicate": doubled[0]}


def test_a_loop_that_hangs_costs_one_timeout_and_the_arm_after_20_missed_ticks(told: Path) -> None:
    (lost,) = [event for event in read_events(told) if event["kind"] == "lost"]
    assert (lost["tick"], lost["agent"], lost["missed_ticks"]) == (HUNG_AT + 19, "a1", 20)
    assert lost["why"] == "20 ticks without an answer", "its sign of life is there"
    wait = read_json(told / "metrics.json")["tick_parts_us"]["wait"]
    assert wait["p50"] < 1e5
    assert read_json(told / "run.json")["measured"]["wall_s"] > 2.0


def test_a_slow_process_leaves_no_trace_and_the_same_faults_the_same(told: Path, tmp_path: Path) -> None:
    folder, status = tell(tmp_path, MESSAGES, hangs=False)
    assert status == 0
    here, there = (read_trace(each / "trace.parquet") for each in (told, folder))
    for name in there:
        np.testing.assert_array_equal(here[name][:HUNG_AT], there[name][:HUNG_AT], err_msg=name)
    assert last_words(told)["loss"] == last_words(folder)["loss"]
    assert last_words(told)["slow"] == "the kernel has stopped it and let it go on, again and again"


def test_a_simulator_that_is_killed_goes_on_from_its_checkpoint_with_agents_and_faults(tmp_path: Path) -> None:
    kill = '[[events]]\nat_s = 0.15\nkind = "sim_kill"\n'
    checkpoints = SCENARIO.replace("every_ticks = 1", "every_ticks = 1\ncheckpoint_s = 0.1")
    path = tmp_path / "story.toml"
    path.write_text(checkpoints.replace("duration_s = 0.5", "duration_s = 0.3") + kill)
    with launched(str(path), tmp_path, {}) as run:
        assert run.command.end() == 0
        run.command.look()
        assert run.command.survivors() == []
    events = [(each["tick"], each["kind"], each.get("agent")) for each in read_events(run.folder)]
    assert [each for each in events if each[1] in ("ordered", "resumed", "seen")] == [
        (150, "ordered", "sim"),
        (100, "resumed", None),
        (100, "seen", "sim"),
    ]
    assert [each for each in events if each[:2] == (100, "joined")] != [], "the same processes have greeted again"
    pids = {each["pid"] for each in read_events(run.folder) if each["kind"] == "joined"}
    assert len(pids) == 2
    np.testing.assert_array_equal(read_trace(run.folder / "trace.parquet")["tick"], np.arange(300))
    assert read_json(run.folder / "run.json")["unproven"] == []
    assert sorted(path.name for path in (run.folder / "logs").glob("sim*")) == ["sim.2.log", "sim.log"]
