"""Links that are really cut: who is cut off lives on, is lost at its tick, greets again, and the bytes repeat."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from processes import read_events, read_json, run_of

from sim_server.trace import read_trace

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]

CUT, HEALED = 200, 400
LEADER_CUT, LEADER_HEALED = 450, 550
SCENARIO = f"""
extends = "transport"
description = "Two arms and a light table; the links of one of them and of the leader are cut, and are there again."
duration_s = 0.8
[team]
count = 2
[load]
mass_kg = 8.0
[record]
every_ticks = 1
[[events]]
at_s = {CUT / 1000}
kind = "disconnect"
agent = "a2"
[[events]]
at_s = {HEALED / 1000}
kind = "reconnect"
agent = "a2"
[[events]]
at_s = {LEADER_CUT / 1000}
kind = "disconnect"
agent = "leader"
[[events]]
at_s = {LEADER_HEALED / 1000}
kind = "reconnect"
agent = "leader"
"""


def test_who_is_cut_off_lives_on_is_lost_and_greets_again_at_certain_ticks(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    one, two = (run_of(SCENARIO, tmp_path_factory.mktemp(name)) for name in ("one", "two"))
    events = read_events(one)
    lost = [(each["tick"], each["agent"], each["why"]) for each in events if each["kind"] == "lost"]
    gone = "its sign of life is gone"
    assert lost == [(CUT, "a2", gone), (LEADER_CUT, "leader", gone)]
    joined: dict[str, list[tuple[int, int, int]]] = {name: [] for name in ("a1", "a2", "leader")}
    for each in events:
        if each["kind"] == "joined":
            joined[each["agent"]].append((each["tick"], each["lease"], each["pid"]))
    assert [each[:2] for each in joined["a2"]] == [(0, 1), (HEALED, 2)]
    assert [each[:2] for each in joined["leader"]] == [(0, 1), (LEADER_HEALED, 2)]
    assert all(len({pid for _, _, pid in lives}) == 1 for lives in joined.values()), "the same process as before"
    run = read_json(one / "run.json")
    assert run["unproven"] == []
    assert run["agents"]["a1"]["missed_ticks"] == 0
    assert read_json(one / "audit.json")["verdict"] == "holds"
    ages = read_trace(one / "trace.parquet")["a2.age_ticks"]
    assert not np.any(ages[:CUT])
    assert not np.any(ages[HEALED:])
    assert (one / "trace.parquet").read_bytes() == (two / "trace.parquet").read_bytes()


def test_one_whose_link_stays_cut_ends_with_the_run_and_a_new_process_has_a_whole_one(tmp_path: Path) -> None:
    without_the_last, _, _ = SCENARIO.rpartition("[[events]]")
    events = read_events(run_of(without_the_last.replace('kind = "reconnect"', 'kind = "start"'), tmp_path))
    seen = [(each["event"], each["agent"]) for each in events if each["kind"] == "seen"]
    assert seen == [("disconnect", "a2"), ("start", "a2"), ("disconnect", "leader")]
    pids = [each["pid"] for each in events if each["kind"] == "joined" and each["agent"] == "a2"]
    assert len(set(pids)) == 2
