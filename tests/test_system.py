"""The whole system as real processes: what a run leaves, what kills it, what outlives it (nothing)."""

from __future__ import annotations

import os
import shutil
import signal
import socket
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from processes import (
    Started,
    both_cores_busy,
    free_port,
    launched,
    port_is_closed,
    read_events,
    read_json,
    run_to_end,
    settings,
    started,
    wait_until,
)

from deploy.agents_told import leader_arguments
from sim_server.metrics import METRICS
from sim_server.scenario_files import load_scenario
from sim_server.trace import columns, read_trace
from wire import PROTOCOL_VERSION
from wire.arms import arm_digest
from wire.codec import decode_any, encode
from wire.keys import Keys
from wire.link import Link
from wire.messages import Goodbye, Hello, Refusal
from wire.zenoh_link import open_client

# A run takes a few seconds; the limit is for a machine that does other things as well.
pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

FOUR = {"duration_s": 1.5, "expect.goal_error_m.max": 3.0, "expect.end_speed_mm_s.max": 1000.0}
"""`transport` for so short a time that the goal is not reached, with bounds that this still holds."""
TWO = {"duration_s": 6.0, "team.count": 2, "load.mass_kg": 8.0}
"""A light table and two arms: two followers, quick to start."""


@dataclass
class Seen:
    """A run that has ended, and what was seen while it went on."""

    folder: Path
    status: int
    said: str
    libraries: dict[str, set[str] | None] = field(default_factory=dict)
    pids: dict[str, int] = field(default_factory=dict)

    @property
    def trace(self) -> bytes:
        return (self.folder / "trace.parquet").read_bytes()


def loaded_libraries(pid: int) -> set[str] | None:
    """Which of the two engines a process has mapped; None if its walls hide that from this user."""
    try:
        maps = Path(f"/proc/{pid}/maps").read_text()
    except PermissionError:
        return None
    return {library for library in ("mujoco", "pinocchio") if library in maps}


def run_transport(cwd: Path, values: Mapping[str, object], *, inspect: bool = False) -> Seen:
    with launched("transport", cwd, values) as run:
        seen = Seen(run.folder, 0, "")
        if inspect:
            run.wait_until_carrying(0.1)
            seen.pids = {name: child.pid for name, child in run.children.items()}
            seen.libraries = {name: loaded_libraries(pid) for name, pid in seen.pids.items()}
        seen.status = run.command.end()
        seen.said = run.command.said()
        if inspect:
            run.wait_until_nobody_is_left()
        return seen


@pytest.fixture(scope="module")
def main_run(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """Four arms carry the table for 1.5 s."""
    return run_transport(tmp_path_factory.mktemp("main"), FOUR, inspect=True)


# A run


def test_a_run_that_holds_its_bounds_ends_with_status_0_and_says_so(main_run: Seen) -> None:
    assert main_run.status == 0, main_run.said
    assert "verdict: holds" in main_run.said
    assert read_json(main_run.folder / "metrics.json")["verdict"] == "holds"
    assert f"run folder: {main_run.folder}" in main_run.said


def test_a_run_leaves_its_whole_folder_and_a_log_per_process(main_run: Seen) -> None:
    files = {path.relative_to(main_run.folder).as_posix() for path in main_run.folder.rglob("*") if path.is_file()}
    logs = {f"logs/{name}.log" for name in ("sim", "a1", "a2", "a3", "a4", "leader")}
    assert files - {"run.png"} == {"run.json", "metrics.json", "audit.json", "trace.parquet", "events.jsonl"} | logs


def test_every_follower_is_a_process_of_its_own(main_run: Seen) -> None:
    run = read_json(main_run.folder / "run.json")
    pids = {name: agent["pid"] for name, agent in run["agents"].items()}
    assert pids == {name: pid for name, pid in main_run.pids.items() if name != "sim"}
    assert set(pids) == {"a1", "a2", "a3", "a4", "leader"}
    assert len({*pids.values(), main_run.pids["sim"]}) == 6


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs /proc")
def test_the_simulator_has_not_the_followers_engine_loaded(main_run: Seen) -> None:
    assert main_run.libraries["sim"] == {"mujoco"}


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs /proc")
def test_no_agent_has_the_simulators_engine_loaded(main_run: Seen) -> None:
    """As seen from outside; what a follower says of itself is in test_walls, for every user."""
    if main_run.libraries["leader"] is None:
        pytest.skip("the walls hide an agent's memory from everybody but root")
    for arm in ("a1", "a2", "a3", "a4"):
        assert main_run.libraries[arm] == {"pinocchio"}
    assert main_run.libraries["leader"] == set()


def test_the_events_tell_who_joined_and_when_it_started_and_ended(main_run: Seen) -> None:
    events = read_events(main_run.folder)
    assert [event["kind"] for event in events] == ["joined"] * 5 + ["started", "ended"]
    assert {event["agent"]: event["pid"] for event in events[:5]} == {
        name: pid for name, pid in main_run.pids.items() if name != "sim"
    }
    assert [event["time_s"] for event in events] == [0.0] * 6 + [1.5]


def test_the_trace_has_a_row_for_every_fifth_tick_and_every_column(main_run: Seen) -> None:
    trace = read_trace(main_run.folder / "trace.parquet")
    widths = {name: 1 if values.ndim == 1 else values.shape[1] for name, values in trace.items()}
    assert widths == columns(("a1", "a2", "a3", "a4"), 7)
    np.testing.assert_array_equal(trace["tick"], np.arange(0, 1500, 5))
    np.testing.assert_allclose(trace["time_s"], np.arange(0, 1500, 5) / 1000, rtol=0, atol=1e-12)
    for arm in ("a1", "a2", "a3", "a4"):
        np.testing.assert_array_equal(trace[f"{arm}.age_ticks"], 0)  # every arm answered every tick


def test_run_json_says_what_ran(main_run: Seen) -> None:
    run = read_json(main_run.folder / "run.json")
    assert (run["scenario_name"], run["seed"], run["clock"]) == ("transport", 1, "lock-step")
    assert run["scenario"]["duration_s"] == 1.5
    assert run["ended"] == {"completed": True, "why": "reached its duration", "ticks": 1500}
    for agent in run["agents"].values():
        assert (agent["phase"], agent["lease"], agent["missed_ticks"], agent["refused"]) == ("ticking", 1, 0, {})
    assert run["versions"]["mujoco"]


def test_the_metrics_known_by_name_are_exactly_those_of_one_number_that_a_run_has(main_run: Seen) -> None:
    metrics = read_json(main_run.folder / "metrics.json")
    scalar = {name for name, value in metrics.items() if value is None or isinstance(value, int | float)}
    assert scalar == set(METRICS)


def test_a_run_moves_the_load_towards_the_goal_by_the_leaders_bounded_pull(main_run: Seen) -> None:
    """Four silent arms that do not disturb: in 1.5 s with 40 N the table has gone some way, level and carried."""
    metrics = read_json(main_run.folder / "metrics.json")
    assert 0.05 < 2.0 - metrics["goal_error_m"] < 1.0
    assert metrics["leader_force_max_N"] <= 40.0
    assert metrics["tilt_max_deg"] < 0.5
    assert sum(metrics["load_share"].values()) == pytest.approx(1.0, abs=0.02)  # carried: no part of it falls


def test_metrics_computed_again_are_the_same_numbers(main_run: Seen, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(main_run.folder, copy)
    (copy / "metrics.json").unlink()
    ended = run_to_end("metrics", copy, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert read_json(copy / "metrics.json") == read_json(main_run.folder / "metrics.json")


def test_the_audit_of_a_run_of_four_arms_holds(main_run: Seen, tmp_path: Path) -> None:
    ended = run_to_end("audit", main_run.folder, cwd=tmp_path)
    assert "no key reached two agents: holds" in ended.stdout, ended.stdout
    assert ended.returncode == 0


# Repeatable


def test_the_same_scenario_and_seed_give_the_same_bytes_while_both_cores_are_busy(
    main_run: Seen, tmp_path: Path
) -> None:
    with both_cores_busy():
        again = run_transport(tmp_path, FOUR)
    assert again.status == 0, again.said
    assert again.trace == main_run.trace


def test_another_seed_is_another_run(main_run: Seen, bereaved_run: Seen) -> None:
    """Before anybody was lost, the two differ by the seed alone."""
    first, second = (read_trace(each.folder / "trace.parquet") for each in (main_run, bereaved_run))
    lost = min(event["tick"] for event in read_events(bereaved_run.folder) if event["kind"] == "lost")
    rows = int(np.count_nonzero(second["tick"] < lost))
    assert rows > 100
    rows = min(rows, len(first["tick"]))
    for name in ("load.position", "a1.q", "a4.tau"):
        assert (first[name][1:rows] != second[name][1:rows]).all(axis=1).any()


# Endings


def readable_rows(folder: Path) -> int:
    """Rows of the trace; they begin at tick 0 and none is missing between."""
    ticks = read_trace(folder / "trace.parquet")["tick"]
    np.testing.assert_array_equal(ticks, 5 * np.arange(len(ticks)))
    return len(ticks)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_interrupted_keeps_what_was_recorded_and_leaves_nobody(
    number: signal.Signals, tmp_path: Path
) -> None:
    with launched("transport", tmp_path, TWO) as run:
        run.wait_until_carrying(0.6)
        os.killpg(run.command.process.pid, number)  # as a terminal does
        assert run.command.end() == 3
        assert f"stopped by {number.name}" in run.command.errors.read_text()
        run.wait_until_nobody_is_left()
    assert readable_rows(run.folder) >= 120
    assert read_json(run.folder / "run.json")["ended"]["completed"] is False
    assert read_json(run.folder / "metrics.json")["duration_s"] >= 0.59
    assert read_events(run.folder)[-1]["why"] == "stopped by the operator"


def test_when_the_launcher_is_killed_all_go_and_the_trace_is_whole(tmp_path: Path) -> None:
    with launched("transport", tmp_path, TWO) as run:
        run.wait_until_carrying(0.6)
        run.command.process.kill()
        run.command.end()
        run.wait_until_nobody_is_left()
    assert readable_rows(run.folder) >= 120
    assert read_json(run.folder / "run.json")["ended"]["completed"] is False


def test_when_the_launcher_is_killed_a_follower_that_is_stopped_goes_too(tmp_path: Path) -> None:
    """It cannot read its closed standard input; the kernel ends it."""
    with launched("transport", tmp_path, TWO) as run:
        run.wait_until_carrying(0.0)
        run.signal("a1", signal.SIGSTOP)
        run.command.process.kill()
        run.command.end()
        run.wait_until_nobody_is_left()


def test_when_the_simulator_is_killed_the_launcher_says_so_and_leaves_nobody(tmp_path: Path) -> None:
    with launched("transport", tmp_path, TWO) as run:
        run.wait_until_carrying(0.6)
        run.signal("sim", signal.SIGKILL)
        assert run.command.end() == 3
        (line,) = run.command.errors.read_text().splitlines()
        assert line.startswith("palanquin: the simulator: ended by SIGKILL")
        assert str(run.folder / "logs" / "sim.log") in line
        run.wait_until_nobody_is_left()


@pytest.fixture(scope="module")
def bereaved_run(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """Four arms, another seed; one follower is killed and, when that has been seen, another is stopped for good."""
    values = {"duration_s": 3.0, "seed": 2, "clock.answer_timeout_s": 2.0}
    with launched("transport", tmp_path_factory.mktemp("bereaved"), values) as run:
        run.wait_until_carrying(0.6)
        run.signal("a2", signal.SIGKILL)
        run.command.wait_until(lambda: run.has("lost", agent="a2"), "the loss of a2")
        run.signal("a3", signal.SIGSTOP)
        run.command.wait_until(lambda: run.has("lost", agent="a3"), "the loss of a3")
        status = run.command.end()
        run.wait_until_nobody_is_left()  # the stopped one included
        return Seen(run.folder, status, run.command.said())


def test_a_run_goes_on_to_its_end_without_the_followers_that_died_or_hang(bereaved_run: Seen) -> None:
    assert bereaved_run.status == 1, bereaved_run.said  # three seconds do not reach the goal
    assert "verdict: violated" in bereaved_run.said
    run = read_json(bereaved_run.folder / "run.json")
    assert run["ended"] == {"completed": True, "why": "reached its duration", "ticks": 3000}
    assert readable_rows(bereaved_run.folder) == 600
    phases = {name: agent["phase"] for name, agent in run["agents"].items()}
    assert phases == {"a1": "ticking", "a2": "lost", "a3": "lost", "a4": "ticking", "leader": "ticking"}


@pytest.mark.parametrize(("arm", "why"), [("a2", "its sign of life is gone"), ("a3", "20 ticks without an answer")])
def test_the_loss_of_a_follower_is_told_with_its_reason_and_what_its_arm_does(
    bereaved_run: Seen, arm: str, why: str
) -> None:
    (lost,) = [each for each in read_events(bereaved_run.folder) if each["kind"] == "lost" and each["agent"] == arm]
    assert lost["why"] == why
    assert lost["then"] == "limp"
    trace = read_trace(bereaved_run.folder / "trace.parquet")
    after = trace["tick"] >= lost["tick"]  # the tick in which it was lost is the first without it
    assert after.any()
    assert not after.all()
    np.testing.assert_array_equal(trace[f"{arm}.stiffness"][after], 0)
    np.testing.assert_array_equal(trace[f"{arm}.base_force"][after], 0)
    assert (trace[f"{arm}.stiffness"][~after][1:] > 0).all()
    np.testing.assert_array_equal(trace["a1.age_ticks"], 0)  # the others go on answering every tick


# Parts by hand


DIGEST = arm_digest("panda")
RUN = "by-hand"


@dataclass
class ByHand:
    """What came of a run whose parts were started one by one, and of everybody who was refused on the way."""

    folder: Path
    replies: dict[str, Refusal | str] = field(default_factory=dict)
    ended: dict[str, tuple[int, str]] = field(default_factory=dict)
    statuses: dict[str, int] = field(default_factory=dict)


def greeting(**changes: Any) -> Hello:
    given: dict[str, Any] = {"role": "follower", "run": RUN, "name": "a1", "arm_model": "panda", "digest": DIGEST}
    return Hello(**{**given, "pid": 1, "host": "elsewhere", **changes})


def reply_to(link: Link, key: str, payload: bytes) -> Refusal | str:
    reply = link.query(key, payload, 10.0)
    if reply is None:
        return "no reply"
    message = decode_any(reply)
    return message if isinstance(message, Refusal) else type(message).__name__


def other_version(hello: Hello) -> bytes:
    body = msgpack.unpackb(encode(hello))
    return msgpack.packb(body | {"v": 999})


def refused_greetings(endpoint: str) -> Iterator[tuple[str, Refusal | str]]:
    """Greetings that must not get in, each over a session of its own."""
    here, elsewhere = Keys(RUN).arm("a1").hello, Keys("other").arm("a1").hello
    for what, key, payload in (
        ("run_of_the_key", elsewhere, encode(greeting(run="other"))),
        ("run_of_the_message", here, encode(greeting(run="other"))),
        ("arm", Keys(RUN).arm("a9").hello, encode(greeting(name="a9"))),
        ("model", here, encode(greeting(arm_model="ur5e"))),
        ("digest", here, encode(greeting(digest="0" * 64))),
        ("role", here, encode(greeting(role="leader"))),
        ("version", here, other_version(greeting())),
        ("goodbye", here, encode(Goodbye("a1", 0))),
    ):
        with open_client(endpoint) as link:
            yield what, reply_to(link, key, payload)


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory: pytest.TempPathFactory) -> ByHand:
    """`palanquin sim`, `palanquin follower`, `palanquin leader`, one after the other, with many who do not belong."""
    cwd = tmp_path_factory.mktemp("by-hand")
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    seen = ByHand(cwd / "run")
    values = {"duration_s": 3.0}

    def follower(name: str, *, run: str = RUN, arm: str = "a1") -> Started:
        agent = ("follower", "--arm", arm, "--run", run, "--connect", endpoint)
        return stack.enter_context(started(*agent, cwd=cwd, name=name))

    with ExitStack() as stack:
        serve = ("--open", "--run", RUN, "--listen", endpoint, *settings(values))
        sim = stack.enter_context(started("sim", "transport-one", "--out", seen.folder, *serve, cwd=cwd, name="sim"))
        sim.wait_until(lambda: f"run {RUN} at {endpoint}, waiting for a1" in sim.output.read_text(), "the simulator")
        seen.replies = dict(refused_greetings(endpoint))
        first = follower("first")
        first.wait_until(lambda: joined(seen.folder, "a1"), "the follower to be let in")
        strangers = {
            "second": follower("second"),
            "wrong_run": follower("wrong_run", run="other"),
            "wrong_arm": follower("wrong_arm", arm="a9"),
        }
        for name, stranger in strangers.items():
            seen.ended[name] = stranger.end(), stranger.errors.read_text()
        lead = (
            "leader",
            "--run",
            RUN,
            "--connect",
            endpoint,
            *leader_arguments(load_scenario("transport-one").scenario),
        )
        leader = stack.enter_context(started(*lead, cwd=cwd, name="leader"))
        sim.wait_until(lambda: any(each["kind"] == "started" for each in read_events(seen.folder)), "the start")
        with open_client(endpoint) as link:
            seen.replies["second_while_ticking"] = reply_to(link, Keys(RUN).arm("a1").hello, encode(greeting()))
        seen.statuses = {"sim": sim.end(), "follower": first.end(), "leader": leader.end()}
        wait_until(lambda: port_is_closed(port), "the port to be closed")
    return seen


def joined(folder: Path, agent: str) -> bool:
    return any(event["kind"] == "joined" and event["agent"] == agent for event in read_events(folder))


def test_parts_that_are_started_by_hand_make_a_run(by_hand: ByHand) -> None:
    assert by_hand.statuses == {"sim": 1, "follower": 0, "leader": 0}  # 1: three seconds do not reach the goal
    assert read_json(by_hand.folder / "metrics.json")["verdict"] == "violated"
    assert readable_rows(by_hand.folder) == 600


@pytest.mark.parametrize(
    ("what", "reason", "said"),
    [
        ("run_of_the_key", "run", ("other", RUN, "--run")),
        ("run_of_the_message", "run", ("other", RUN)),
        ("arm", "arm", ("a9",)),
        ("model", "model", ("ur5e", "panda")),
        ("digest", "digest", ("000000000000", DIGEST[:12], "same release")),
        ("role", "role", ("leader", "follower")),
        ("version", "version", ("999", f"expected {PROTOCOL_VERSION}", "same release")),
        ("goodbye", "phase", ("absent",)),
        ("second_while_ticking", "taken", ("a1", "ticking", "one instance")),
    ],
)
def test_who_does_not_belong_is_refused_at_hello_with_the_reason(
    by_hand: ByHand, what: str, reason: str, said: tuple[str, ...]
) -> None:
    refusal = by_hand.replies[what]
    assert isinstance(refusal, Refusal), refusal
    assert refusal.reason == reason
    for words in said:
        assert words in refusal.text


@pytest.mark.parametrize(
    ("who", "said"),
    [("second", ("taken", "a1")), ("wrong_run", ("run", "other", RUN)), ("wrong_arm", ("arm", "a9"))],
)
def test_a_follower_that_is_refused_ends_with_status_2_and_the_simulators_sentence(
    by_hand: ByHand, who: str, said: tuple[str, ...]
) -> None:
    status, errors = by_hand.ended[who]
    assert status == 2
    (line,) = errors.splitlines()
    assert "the simulator refused this agent" in line
    for words in said:
        assert words in line


def test_who_was_refused_did_not_disturb_the_one_who_was_in(by_hand: ByHand) -> None:
    run = read_json(by_hand.folder / "run.json")
    agent = run["agents"]["a1"]
    assert (agent["phase"], agent["lease"], agent["missed_ticks"]) == ("ticking", 1, 0)
    kinds = [event["kind"] for event in read_events(by_hand.folder)]
    assert "lost" not in kinds
    assert kinds.count("joined") == 2
    np.testing.assert_array_equal(read_trace(by_hand.folder / "trace.parquet")["a1.age_ticks"], 0)


def test_every_refusal_is_counted(by_hand: ByHand) -> None:
    # Nine greetings over the wire and three processes.
    assert read_json(by_hand.folder / "metrics.json")["refused_messages"] == 12
    reasons = {event["reason"] for event in read_events(by_hand.folder) if event["kind"] == "refused"}
    assert reasons == {"run", "arm", "model", "digest", "role", "version", "phase", "taken"}


# Could not run


def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        ended = run_to_end("sim", "hold", "--open", "--listen", f"tcp/127.0.0.1:{port}", cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert f"port {port} is in use" in line
    assert "--listen" in line
    assert ended.returncode == 3
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_controller_names_the_known_ones(tmp_path: Path) -> None:
    ended = run_to_end("run", "transport", *settings({"team.controller": "papre"}), cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "papre" in line
    assert "expected one of paper" in line
    assert ended.returncode == 2
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_gain_names_the_known_ones(tmp_path: Path) -> None:
    ended = run_to_end("run", "transport", *settings({"team.gains.strength": 3}), cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "strength" in line
    assert "alpha, beta, adaptive" in line
    assert ended.returncode == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["run", "sim"])
def test_a_run_folder_is_never_written_over(main_run: Seen, tmp_path: Path, command: str) -> None:
    def content() -> dict[Path, tuple[bytes, int]]:
        files = [path for path in main_run.folder.rglob("*") if path.is_file()]
        return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in files}

    before = content()
    listen = ["--open", "--listen", f"tcp/127.0.0.1:{free_port()}"] if command == "sim" else []
    ended = run_to_end(command, "transport", "--out", main_run.folder, *listen, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert f"{main_run.folder} holds a run already" in line
    assert "--out" in line
    assert ended.returncode == 2
    assert content() == before
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_no_run_has_no_metrics(tmp_path: Path) -> None:
    ended = run_to_end("metrics", tmp_path, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "is no run folder" in line
    assert ended.returncode == 2
    assert list(tmp_path.iterdir()) == []
