"""A simulator that is killed and started again, in one process: what it goes on with, to the byte, what it refuses."""

from __future__ import annotations

import errno
import hashlib
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench import RUN, MemoryAgent
from plants import plant_of, scenario
from processes import read_events, read_json

from agents.follower import Follower, FollowerSettings
from agents.leader import LeaderSettings, pull
from deploy.resuming import checkpoint_to_resume
from sim_server import checkpoint, checkpoint_file
from sim_server.checkpoint_file import Checkpoint, CheckpointError, read_checkpoint, write_checkpoint
from sim_server.disk import DiskFailed
from sim_server.mujoco_plant import MujocoPlant
from sim_server.reception import LEADER
from sim_server.run_folder import RunFolder, RunFolderError
from sim_server.scenario_files import load_scenario
from sim_server.server import NobodyCame, Outcome, Server
from sim_server.snapshot import SnapshotError, pack, unpack
from sim_server.trace import read_trace
from sim_server.trace_rows import RowsLost
from wire.codec import decode, encode
from wire.errors import Refused
from wire.memory import Broker
from wire.messages import LeaderView, State, Welcome

TICKS, EVERY, KILLED_AT = 90, 20, 71
"""The last checkpoint before the kill is that of tick 60."""
SHORT: Mapping[str, Any] = {"duration_s": TICKS / 1000, "record": {"every_ticks": 1, "checkpoint_s": EVERY / 1000}}


STIFFNESS = np.arange(7.0)
STATE = "checkpoint/0000000060.state"


class Killed(BaseException):
    """The simulator's end in the middle of a tick: nobody catches it, nothing more is written."""


def team(broker: Broker, server_scenario: Any, kill_at: int | None) -> list[MemoryAgent]:
    """Real followers and a leader that answer inside the publication of their state."""
    agents = []
    for arm in server_scenario.arms:
        follower = Follower(FollowerSettings(RUN, arm, "panda", "paper", {}))

        def answer(agent: MemoryAgent, state: State | LeaderView, follower: Follower = follower) -> None:
            assert isinstance(state, State)
            if state.tick == kill_at:
                raise Killed
            with suppress(Refused):  # as the follower's own loop
                follower.check(state)
                agent.publisher.put(encode(follower.answer(state, agent.lease, 1e-3)))

        agents.append(MemoryAgent(broker, arm, answer, follower.hello()))
    wanted = LeaderSettings(RUN, server_scenario.leader.goal_m, server_scenario.leader.force_max_N)
    newest = -1

    def lead(agent: MemoryAgent, view: State | LeaderView) -> None:
        nonlocal newest
        assert isinstance(view, LeaderView)
        if view.tick <= newest:
            return
        newest = view.tick
        point = decode(agent.greeting.replies[0], Welcome).points["front"]
        agent.force(view.tick, tuple(pull(view, np.array(point), wanted).tolist()))

    return [*agents, MemoryAgent(broker, LEADER, lead)]


def begin(folder: Path, changes: Mapping[str, Any], kill_at: int | None = None) -> Outcome | None:
    """A run of two arms; None if it was killed."""
    named = load_scenario("transport", {"team": {"count": 2}, "load": {"mass_kg": 8.0}, **SHORT, **changes})
    broker = Broker()
    server = Server(broker.link(), named, RUN, RunFolder(folder))
    team(broker, named.scenario, kill_at)
    try:
        return server.run()
    except Killed:
        return None


def go_on(folder: Path, kill_at: int | None = None) -> tuple[Outcome | None, list[MemoryAgent]]:
    checkpoint = read_checkpoint(folder)
    broker = Broker()
    server = Server(broker.link(), checkpoint.named, checkpoint.run, RunFolder.of_a_run(folder), checkpoint=checkpoint)
    agents = team(broker, checkpoint.named.scenario, kill_at)
    try:
        return server.run(), agents
    except Killed:
        return None, agents


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run whose simulator was killed."""
    folder = tmp_path_factory.mktemp("killed") / "run"
    assert begin(folder, {}, KILLED_AT) is None
    return folder


@pytest.fixture
def copy(killed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(killed, tmp_path / "run"))


# The plant


def drive(plant: MujocoPlant, ticks: int, arms: tuple[str, ...]) -> np.ndarray[Any, Any]:
    """Rows of so many ticks, in which these arms hold their torque and wobble; the noise goes into the commands."""
    rows = []
    for _ in range(ticks):
        readings = plant.read()
        for arm, reading in readings.items():
            if arm in arms:
                plant.command(arm, np.array(reading.tau) + 0.1 * np.sin(plant.tick), (1.0, 2.0, 0.1), STIFFNESS)
        plant.pull("front", np.array([10.0 * np.sin(0.01 * plant.tick), 1.0, 0.0]))
        before = plant.state_row()
        plant.step()
        felt = [np.array(reading.qd + reading.wrench) for reading in readings.values()]
        rows.append(np.concatenate([*felt, *(part.ravel() for part in plant.force_row(before))]))
    return np.array(rows)


def test_two_plants_of_one_state_go_on_equally_number_for_number() -> None:
    """With noise, commands on the way, a bad grasp, an open hand, a lost arm and one that is let down."""
    given = scenario(4, plant={"delay_ticks": 3}, team={"count": 4, "when_lost": "brake", "leave_s": 0.2})
    plant, other = plant_of(given), plant_of(given)
    drive(plant, 30, ("a1", "a2", "a3", "a4"))
    plant.loosen("a2", 20.0)
    plant.lose("a3")
    drive(plant, 250, ("a1", "a2", "a4"))
    plant.let_down("a4")
    plant.slip("a1")
    drive(plant, 5, ("a2",))
    saved = pack(plant.state())
    other.restore(unpack(saved))
    assert pack(other.state()) == saved
    assert plant.hands.opened == ["a1"]
    np.testing.assert_array_equal(drive(plant, 2, ()), drive(other, 2, ()))  # everybody misses two ticks
    np.testing.assert_array_equal(drive(plant, 300, ("a2",)), drive(other, 300, ("a2",)))
    assert plant.hands.opened == ["a1", "a4"]
    for each in (plant, other):
        each.regain("a3")
    np.testing.assert_array_equal(drive(plant, 20, ("a2", "a3")), drive(other, 20, ("a2", "a3")))


def test_a_plant_does_not_take_the_state_of_another_world() -> None:
    other = plant_of(scenario(3)).state() | {"seats": [["a1", 0], ["a2", 1]]}
    with pytest.raises(ValueError, match="numbers, expected"):
        plant_of(scenario(2)).restore(other)
    with pytest.raises(SnapshotError, match="a strut of this load"):
        plant_of(scenario(2)).restore(plant_of(scenario(2)).state() | {"seats": [["a1", 0], ["a2", 99]]})


# A run


def test_a_run_that_was_killed_goes_on_to_its_end_and_leaves_one_whole_folder(copy: Path, tmp_path: Path) -> None:
    assert sorted(files(copy)) == [
        "checkpoint/0000000060.state",
        "events.jsonl",
        "trace.parts/0001.rows",
    ]
    outcome, agents = go_on(copy)
    assert outcome is not None
    assert (outcome.completed, outcome.why) == (True, "reached its duration")
    assert sorted(files(copy)) == ["audit.json", "events.jsonl", "metrics.json", "run.json", "trace.parquet"]
    np.testing.assert_array_equal(read_trace(copy / "trace.parquet")["tick"], np.arange(TICKS))
    run = read_json(copy / "run.json")
    assert run["ended"]["ticks"] == TICKS
    (resumed,) = run["resumed"]
    assert (resumed["tick"], resumed["time_s"]) == (60, 0.06)
    assert run["checkpoints"]["written"] == 2  # at 60, where it went on, and at 80
    events = read_events(copy)
    kinds = [(event["kind"], event["tick"]) for event in events]
    joined = [("joined", 0)] * 3
    assert kinds == [*joined, ("started", 0), ("resumed", 60), *[("joined", 60)] * 3, ("ended", TICKS)]
    assert [state.tick for state in agents[0].seen] == list(range(60, TICKS))
    counts = {
        (row["agent"], row["key"].rpartition("/")[2]): row["messages"]
        for row in read_json(copy / "audit.json")["counts"]
    }
    assert counts["a1", "state"] == TICKS
    assert counts["a1", "command"] == TICKS
    assert counts["a1", "hello"] in (2, 4)  # the greetings, or their replies
    assert read_json(copy / "metrics.json")["duration_s"] == pytest.approx((TICKS - 1) / 1000)


def test_every_repetition_leaves_the_same_trace(killed: Path, tmp_path: Path) -> None:
    traces = set()
    for number in range(2):
        folder = Path(shutil.copytree(killed, tmp_path / str(number)))
        go_on(folder)
        traces.add((folder / "trace.parquet").read_bytes())
    assert len(traces) == 1


def test_up_to_the_checkpoint_the_trace_is_that_of_a_run_that_was_not_killed(copy: Path, tmp_path: Path) -> None:
    """After it, only the laws differ, which begin anew: the first torque is the one that the arm carries."""
    begin(tmp_path / "whole", {})
    go_on(copy)
    whole, resumed = (read_trace(folder / "trace.parquet") for folder in (tmp_path / "whole", copy))
    for name in whole:
        np.testing.assert_array_equal(whole[name][:60], resumed[name][:60])
    for name in ("load.position", "load.linear_velocity", "a1.q", "a2.qd", "leader.force"):  # tick 60 begins alike
        np.testing.assert_array_equal(whole[name][60], resumed[name][60])
    torque = np.abs(resumed["a1.tau"][60] - resumed["a1.tau"][59])
    assert torque.max() <= 0.25  # five standard deviations of the torque sensor's noise: no bump


def test_checkpoints_change_nothing_in_the_trace(tmp_path: Path) -> None:
    for name, every_s in (("with", 0.02), ("without", 0.0)):
        begin(tmp_path / name, {"record": {"every_ticks": 1, "checkpoint_s": every_s}})
    with_, without = (tmp_path / name / "trace.parquet" for name in ("with", "without"))
    assert with_.read_bytes() == without.read_bytes()
    assert read_json(tmp_path / "without" / "run.json")["checkpoints"]["written"] == 0


def test_a_run_can_be_killed_again_also_before_its_next_checkpoint(copy: Path, killed: Path, tmp_path: Path) -> None:
    once = Path(shutil.copytree(killed, tmp_path / "once"))
    go_on(once)
    for kill_at in (75, 85, 86):
        assert go_on(copy, kill_at)[0] is None
    go_on(copy)
    run = read_json(copy / "run.json")
    assert [resumed["tick"] for resumed in run["resumed"]] == [60, 60, 80, 80]
    np.testing.assert_array_equal(read_trace(copy / "trace.parquet")["tick"], np.arange(TICKS))
    first, again = (read_trace(folder / "trace.parquet")["a1.tau"] for folder in (once, copy))
    np.testing.assert_array_equal(first[:80], again[:80])


def test_a_run_can_be_killed_while_it_ends(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def die(*_: object) -> None:
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr("sim_server.server.describe_run", die)
        assert go_on(copy)[0] is None
    assert (copy / "trace.parquet").exists()
    assert go_on(copy)[0] is not None
    np.testing.assert_array_equal(read_trace(copy / "trace.parquet")["tick"], np.arange(TICKS))
    assert [resumed["tick"] for resumed in read_json(copy / "run.json")["resumed"]] == [60, 80]


def test_what_happened_after_the_checkpoint_stays_in_the_events_and_is_marked(copy: Path) -> None:
    with (copy / "events.jsonl").open("a") as events:
        events.write('{"tick": 70, "time_s": 0.07, "kind": "missed", "agent": "a1"}\n{"tick": 71, "ki')
    go_on(copy)
    undone = [event for event in read_events(copy) if event.get("undone")]
    assert undone == [{"tick": 70, "time_s": 0.07, "kind": "missed", "agent": "a1", "undone": True}]


def test_a_lost_arm_stays_lost_and_nobody_waits_for_it(tmp_path: Path) -> None:
    events = [{"at_s": 0.01, "kind": "fail_grasp", "arm": "a2", "for_s": 0.035}]
    begin(tmp_path / "run", {"events": events}, KILLED_AT)
    checkpoint = read_checkpoint(tmp_path / "run")
    a2 = checkpoint.content["agents"]["agents"]["a2"]["link"]
    a2["phase"] = "lost"
    broker = Broker()
    server = Server(broker.link(), checkpoint.named, RUN, RunFolder.of_a_run(tmp_path / "run"), checkpoint=checkpoint)
    team(broker, checkpoint.named.scenario, None)[1].link.close()  # comes, and goes before anybody looked
    assert server.run().completed
    kinds = [(event["kind"], event.get("agent")) for event in read_events(tmp_path / "run")]
    assert kinds.count(("hand_opened", "a2")) == 1  # before the checkpoint, and not again
    assert ("joined", "a1") in kinds
    assert read_json(tmp_path / "run" / "run.json")["agents"]["a2"]["phase"] == "lost"


def test_who_was_in_is_waited_for_and_a_run_that_nobody_comes_back_to_stands_where_it_stood(copy: Path) -> None:
    checkpoint = read_checkpoint(copy)
    before = files(copy)
    named = load_scenario(
        "transport", {**checkpoint.named.scenario.model_dump(mode="json"), "clock": {"start_timeout_s": 0.05}}
    )
    broker = Broker()
    server = Server(broker.link(), named, RUN, RunFolder.of_a_run(copy), checkpoint=checkpoint)
    a1, a2, _ = team(broker, named.scenario, None)
    a2.link.close()
    with pytest.raises(NobodyCame, match="for a2: not there"):
        server.run()
    assert a1.ended == ""  # so it waits for the next simulator
    after = files(copy)
    changed = {name for name in after if before.get(name) != after[name]}
    assert changed <= {"events.jsonl", "trace.parts/0001.rows"}
    assert go_on(copy)[0] is not None
    np.testing.assert_array_equal(read_trace(copy / "trace.parquet")["tick"], np.arange(TICKS))


# What cannot go on: one clear sentence, and nothing changes


def take_up(checkpoint: Checkpoint | None) -> Server:
    assert checkpoint is not None
    again = RunFolder.of_a_run(checkpoint.folder)
    return Server(Broker().link(), checkpoint.named, checkpoint.run, again, checkpoint=checkpoint)


def refused(folder: Path, **options: Any) -> str:
    """Why the folder cannot be resumed; fails if anything in it changes."""
    given: dict[str, Any] = {"scenario": None, "changes": {}, "run": None, "out": None, **options}
    before = files(folder) if folder.is_dir() else {}
    with pytest.raises(CheckpointError) as error:
        take_up(checkpoint_to_resume(folder, **given))
    assert error.value.exit_status == 2
    assert (files(folder) if folder.is_dir() else {}) == before
    text = str(error.value)
    assert str(folder) in text
    assert "\n" not in text
    return text


def rewrite(folder: Path, change: Mapping[str, Any]) -> None:
    """A checkpoint of other content with a checksum that is right."""
    content = {**read_checkpoint(folder).content, **change}
    body = pack(content)
    head = f"{checkpoint_file.HEAD} {checkpoint_file.VERSION} {hashlib.sha256(body).hexdigest()}\n"
    (folder / STATE).write_bytes(head.encode() + body)


def test_no_such_run_and_no_checkpoint(tmp_path: Path) -> None:
    assert "no such folder" in refused(tmp_path / "nowhere")
    assert "no checkpoint in it" in refused(tmp_path)


def test_a_run_that_has_ended(tmp_path: Path) -> None:
    begin(tmp_path / "run", {})
    said = refused(tmp_path / "run")
    assert "has ended in order (reached its duration)" in said


def test_between_its_rows_and_its_file_a_checkpoint_is_not_there_and_the_one_before_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread writes while the ticks go on: killed between any two things that it does, the run goes on."""
    copies: list[Path] = []

    def write(file: Path, body: bytes, before: Path | None) -> None:
        copies.append(Path(shutil.copytree(tmp_path / "run", tmp_path / f"{len(copies)}")))
        write_checkpoint(file, body, before)

    monkeypatch.setattr(checkpoint, "write_checkpoint", write)
    begin(tmp_path / "run", {})
    assert [path.name for path in copies] == [f"{k}" for k in range(5)]
    whole = read_trace(tmp_path / "run" / "trace.parquet")
    for k, copied in enumerate(copies[1:]):
        outcome, _ = go_on(copied)
        assert outcome is not None
        assert read_json(copied / "run.json")["resumed"][0]["tick"] == k * EVERY
        trace = read_trace(copied / "trace.parquet")
        np.testing.assert_array_equal(trace["tick"], np.arange(TICKS))
        np.testing.assert_array_equal(trace["a1.q"][: k * EVERY], whole["a1.q"][: k * EVERY])


@pytest.mark.parametrize("fails_at", [2, 5])
def test_a_disk_that_is_full_ends_the_run_with_a_sentence_and_the_checkpoint_before_is_good(
    fails_at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fifth is the last of the run: that nothing is handed over after it hides nothing."""
    count = 0

    def write(file: Path, body: bytes, before: Path | None) -> None:
        nonlocal count
        count += 1
        if count == fails_at:
            raise OSError(errno.ENOSPC, "No space left on device")
        write_checkpoint(file, body, before)

    monkeypatch.setattr(checkpoint, "write_checkpoint", write)
    with pytest.raises(DiskFailed, match=r"No space left on device.*--resume RUN"):
        begin(tmp_path / "run", {})
    assert not (tmp_path / "run" / "run.json").exists()
    monkeypatch.undo()
    outcome, _ = go_on(tmp_path / "run")
    assert outcome is not None
    assert outcome.completed
    assert read_json(tmp_path / "run" / "run.json")["resumed"][0]["tick"] == (fails_at - 2) * EVERY
    np.testing.assert_array_equal(read_trace(tmp_path / "run" / "trace.parquet")["tick"], np.arange(TICKS))


def test_another_version(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    latest = copy / STATE
    data = latest.read_bytes()
    latest.write_bytes(data.replace(b"checkpoint 5 ", b"checkpoint 7 ", 1))
    assert "version 7, expected 5" in refused(copy)
    latest.write_bytes(data)
    rewrite(copy, {"versions": {"palanquin": "0.1.0", "mujoco": "2.0"}})
    assert "install mujoco 2.0" in refused(copy)


@pytest.mark.parametrize("how", ["cut", "flipped", "empty", "another file"])
def test_a_spoiled_file(copy: Path, how: str) -> None:
    latest = copy / STATE
    data = bytearray(latest.read_bytes())
    data[-100] ^= 1
    spoiled = {"cut": bytes(data[:500]), "flipped": bytes(data), "empty": b"", "another file": b"PAR1\n\x00\n" * 9}
    latest.write_bytes(spoiled[how])
    assert "spoiled or of another program" in refused(copy)


@pytest.mark.parametrize(
    "change",
    [
        {"plant": {}},
        {"plant": 3},
        {"scenario": {"description": "x"}},
        {"agents": {"agents": {}, "strangers": {}}},
        {"happenings": {"due": 99, "wanted": [], "slips": [], "number": 0}},
        {"timings": {"send": 3}},
        {"trace": [[["a1", "a2"]]]},
        {"tallies": {"rows": [[1]]}},
        {"started_at": "yesterday"},
    ],
)
def test_content_that_does_not_fit(copy: Path, change: Mapping[str, Any]) -> None:
    rewrite(copy, change)
    assert "spoiled or of another program" in refused(copy)


def test_rows_that_are_missing(copy: Path) -> None:
    (copy / "trace.parts" / "0001.rows").write_bytes(b"")
    before = files(copy)
    with pytest.raises(RowsLost, match=r"0001\.rows: got 0 bytes") as error:
        take_up(read_checkpoint(copy))
    assert error.value.exit_status == 2
    assert files(copy) == before


def test_another_scenario_run_or_folder(copy: Path) -> None:
    changes = {"team": {"count": 2}, "load": {"mass_kg": 9.0}, **SHORT}
    assert "load.mass_kg: got 9.0, expected 8.0" in refused(copy, scenario="transport", changes=changes)
    assert "--seed or --set" in refused(copy, changes={"seed": 2})
    assert f"got --run other, expected {RUN}" in refused(copy, run="other")
    assert "--out elsewhere" in refused(copy, out=Path("elsewhere"))
    same = changes | {"load": {"mass_kg": 8.0}}
    found = checkpoint_to_resume(copy, "transport", same, RUN, None)
    assert isinstance(found, Checkpoint)


def test_a_run_whose_simulator_is_still_there(copy: Path) -> None:
    first = RunFolder.of_a_run(copy)
    with pytest.raises(RunFolderError, match="a simulator is writing this run"):
        RunFolder.of_a_run(copy)
    first.close()
    RunFolder.of_a_run(copy).close()
