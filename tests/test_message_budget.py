"""docs/silence.md lists every field that can reach a follower; here real runs show that no more than that is told."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from bench import ask

from deploy.agents_told import follower_arguments
from sim_server.layout import Pose
from sim_server.mujoco_plant import MujocoPlant
from sim_server.run_folder import RunFolder
from sim_server.scenario import Scenario
from sim_server.scenario_files import NamedScenario, load_scenario
from sim_server.server import Server
from sim_server.world import build_world
from wire.arms import arm_digest
from wire.codec import SCHEMAS, decode, decode_any, encode
from wire.keys import Keys
from wire.memory import Broker, MemoryQuestion
from wire.messages import Command, Hello, LeaderForce, LeaderView, Refusal, State, Welcome

DOCS = Path(__file__).resolve().parent.parent / "docs"
RUN = "budget"


def table(page: str, mark: str) -> list[list[str]]:
    """The rows of the table after an invisible mark."""
    lines = (DOCS / page).read_text(encoding="utf-8").partition(f"<!-- {mark} -->\n")[2].splitlines()
    rows = lines[: next(k for k, line in enumerate(lines) if not line.startswith("|"))]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows[2:]]


def reach_a_follower() -> set[str]:
    """Messages on the keys that lead to a follower, as docs/wire.md (and so tests/test_wire_doc.py) has them."""
    found: set[str] = set()
    for key, _, _, to, messages in table("wire.md", "keys"):
        if "/arm/" in key and "follower" in to:
            found |= set(re.findall(r"`(\w+)`", messages))
        elif "/arm/" in key:
            found |= set(re.findall(r"`(\w+)`", messages.partition("replies")[2]))
    return found


def test_the_budget_has_every_field_that_can_reach_a_follower_and_no_other() -> None:
    assert reach_a_follower() == {"state", "end", "welcome", "refusal", "leaving", "goodbye"}
    fields = {f"{kind}.{name}" for kind in reach_a_follower() for name in SCHEMAS[kind][1]}
    assert {row[0].strip("`") for row in table("silence.md", "budget")} == fields


def test_no_field_of_the_budget_tells_of_anybody_but_the_follower_and_the_clock() -> None:
    allowed = {"itself", "the clock", "its own joints", "its own wrist", "its own hand", "its own base", "nothing"}
    for name, about, why in table("silence.md", "budget"):
        assert about in allowed, name
        assert why


# What it hears in a run


@dataclass
class Ear:
    """Everything that reaches arm a1 in a run, in bytes."""

    welcome: bytes = b""
    states: list[bytes] = field(default_factory=list)
    end: bytes = b""


def listen(named: NamedScenario, folder: Path) -> Ear:
    """A real server, MuJoCo and all, over the in-memory wire: every arm holds the torque it feels, nobody pulls."""
    broker, ear, keys = Broker(), Ear(), Keys(RUN)
    server = Server(broker.link(), named, RUN, RunFolder(folder))

    def join(name: str, hello: Hello) -> MemoryQuestion:
        its = keys.leader if name == "leader" else keys.arm(name)
        link = broker.link()
        publisher = link.publisher(its.command)

        def answer(payload: bytes) -> None:
            message = decode_any(payload)
            if name == "a1":
                if isinstance(message, State):
                    ear.states.append(payload)
                else:
                    ear.end = payload
            if isinstance(message, State):
                zeros = (0.0,) * 7
                publisher.put(encode(Command(name, message.tick, 1, message.tau, (0.0, 0.0, 0.0), 0.0, zeros, 0.0, 0)))
            elif isinstance(message, LeaderView):
                publisher.put(encode(LeaderForce(message.tick, 1, "centre", (0.0, 0.0, 0.0))))
            else:
                link.close()

        link.subscribe(its.state, answer)
        question = ask(broker, its.hello, hello)
        link.declare_alive(its.alive)
        return question

    arm = named.scenario.team.arm
    greetings = {
        name: join(name, Hello("follower", RUN, name, arm, arm_digest(arm), 1, "here")) for name in named.scenario.arms
    }
    if named.scenario.leader is not None:
        join("leader", Hello("leader", RUN, "leader", "", "", 1, "here"))
    server.run()
    (ear.welcome,) = greetings["a1"].replies
    return ear


BRIEF: dict[str, Any] = {"duration_s": 0.02}


def scenario(**changes: Any) -> NamedScenario:
    return load_scenario("transport", {**BRIEF, **changes})


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Ear:
    return listen(scenario(), tmp_path_factory.mktemp("usual") / "run")


OTHERWISE: dict[str, dict[str, Any]] = {
    "another goal": {"leader": {"goal_m": [-3.0, 7.0], "point": "left"}},
    "another leader": {"leader": {"goal_m": [2.0, 0.0], "force_max_N": 5.0, "period_ms": 20}},
    "another purpose": {"description": "the secret of the house", "duration_s": 0.02, "expect": {}},
}


@pytest.mark.parametrize("changes", OTHERWISE.values(), ids=OTHERWISE)
def test_the_goal_the_leader_and_the_purpose_change_no_byte_that_a_follower_hears(
    usual: Ear, changes: dict[str, Any], tmp_path: Path
) -> None:
    """As long as nobody pulls: what the leader does is felt, what it wants is not told."""
    other = listen(scenario(**changes), tmp_path / "run")
    assert len(usual.states) == 20
    assert other == usual


@pytest.mark.parametrize(
    "changes",
    [
        {"team": {"count": 3, "controller": "paper"}},
        {"load": {"mass_kg": 9.0}},
        {"load": {"struts": 5, "size_m": [2.4, 1.2, 0.75]}, "team": {"count": 5}},
    ],
    ids=["fewer arms", "lighter load", "larger load and more arms"],
)
def test_the_others_and_the_load_are_felt_in_the_forces_and_told_nowhere_else(
    usual: Ear, changes: dict[str, Any], tmp_path: Path
) -> None:
    """The welcome, the end and the first angles and velocities are the same bytes; torque and wrench carry the load."""
    other = listen(scenario(**changes), tmp_path / "run")
    assert (other.welcome, other.end) == (usual.welcome, usual.end)
    first, second = decode(usual.states[0], State), decode(other.states[0], State)
    assert (first.arm, first.tick, first.time_ns, first.q, first.qd) == (
        second.arm,
        second.tick,
        second.time_ns,
        second.q,
        second.qd,
    )
    assert first.wrench != second.wrench  # else nothing would have been changed


def test_a_followers_welcome_holds_nothing_of_the_load(usual: Ear) -> None:
    welcome = decode(usual.welcome, Welcome)
    assert (welcome.points, welcome.force_max_N, welcome.lease) == ({}, 0.0, 1)
    assert welcome.strut == (0.0,) * 7
    assert {decode(state, State).odometry for state in usual.states} == {(0.0,) * 6}


def moved(scenario: Scenario, X_VW: Pose) -> MujocoPlant:
    """A plant some time into a carry, after which the whole of the world is moved by ``X_VW``, velocities included."""
    world = build_world(scenario)
    plant = MujocoPlant(world)
    for tick in range(40):  # each arm pushes its base another way, so that all joints and bases move
        for k, (name, reading) in enumerate(plant.read().items()):
            push = 60.0 * np.array([np.sin(k), np.cos(k), 0.2])
            plant.command(name, reading.tau + 0.5 * np.sin(0.1 * tick + k), push, np.zeros(7))
        plant.step()
    data = world.data
    for ids in world.arms.values():
        x, y, yaw = data.qpos[ids.base_qpos]
        X_VB = X_VW.compose(Pose.planar(x, y, 0.0, yaw))
        data.qpos[ids.base_qpos] = *X_VB.p[:2], X_VB.yaw
        vx, vy, turn = data.qvel[ids.base_dof]
        data.qvel[ids.base_dof] = *(X_VW.R @ [vx, vy, 0.0])[:2], turn
    pose = data.qpos[world.load_qpos]
    turned = np.zeros(4)
    mujoco.mju_mulQuat(turned, np.array([np.cos(X_VW.yaw / 2), 0, 0, np.sin(X_VW.yaw / 2)]), pose[3:])
    data.qpos[world.load_qpos] = np.concatenate([X_VW.p + X_VW.R @ pose[:3], turned])
    data.qvel[world.load_dof][:3] = X_VW.R @ data.qvel[world.load_dof][:3]
    data.qacc_warmstart[:] = 0.0  # the solver's memory of accelerations in the old place
    plant._apply_efforts()
    mujoco.mj_forward(world.model, data)
    return plant


@pytest.mark.parametrize(
    "X_VW",
    [Pose.planar(30.0, -12.0), Pose.planar(0.0, 0.0, 0.0, 2.0), Pose.planar(-4.0, 9.0, 0.0, -0.7)],
    ids=["moved", "turned", "both"],
)
def test_where_in_the_world_the_team_stands_changes_nothing_that_an_arm_feels(X_VW: Pose) -> None:
    quiet = {name: 0.0 for name in ("position_noise_rad", "velocity_noise_rad_s", "torque_noise_Nm")}
    quiet |= {"wrench_noise_N": 0.0, "wrench_noise_Nm": 0.0}
    given = scenario(plant=quiet).scenario
    here, there = moved(given, Pose.planar(0.0, 0.0)).read(), moved(given, X_VW).read()
    for arm, reading in here.items():
        assert np.abs(reading.qd).max() > 1e-3  # it does move
        for sense in ("q", "qd", "tau"):
            np.testing.assert_array_equal(getattr(there[arm], sense), getattr(reading, sense))
        # Computed from the whole world's accelerations: rounding, and the contact solver's own tolerance.
        np.testing.assert_allclose(there[arm].wrench, reading.wrench, rtol=0, atol=1e-4)


def test_what_a_follower_is_told_at_its_start_is_its_own_arm_and_law() -> None:
    """Another load, goal and count: the same words on the command line."""
    words = follower_arguments(scenario().scenario)
    others: list[dict[str, Any]] = [{"team": {"count": 3}}, {"load": {"mass_kg": 9.0}}, *OTHERWISE.values()]
    for changes in others:
        assert follower_arguments(scenario(**changes).scenario) == words
    assert {word for word in words if word.startswith("--")} <= {
        "--arm-model",
        "--controller",
        "--handover-s",
        "--leave-s",
        "--set",
    }


def test_a_refusal_of_an_unknown_name_names_nobody_else(tmp_path: Path) -> None:
    broker = Broker()
    server = Server(broker.link(), scenario(), RUN, RunFolder(tmp_path / "run"))
    question = ask(broker, Keys(RUN).arm("a9").hello, Hello("follower", RUN, "a9", "panda", "", 1, "here"))
    server._clock.take(server._reception.inbox.get())
    refusal = decode(question.replies[0], Refusal)
    assert "a9" in refusal.text
    assert not re.search(r"\ba[1-8]\b|leader|\b4\b", refusal.text)
