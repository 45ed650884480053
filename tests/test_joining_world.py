"""A world exchanged for one with other robots: what stays goes on as it was, what comes takes hold gently."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agents.arm_model import ArmModel
from agents.reach import Reach, ReachFailed
from sim_server.grasping import load_pose
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario import Scenario
from sim_server.snapshot import pack, unpack
from sim_server.world import build_world, with_robots
from sim_server.world_builder import Build, NotBuilt

SEATS = {"a1": 0, "a2": 1, "a3": 2}


def scenario(**changes: Any) -> Scenario:
    given: dict[str, Any] = {
        "description": "a test",
        "team": {"count": 3, "when_lost": "brake"},
        "load": {"struts": 5},
    }
    return Scenario.model_validate(given | changes)


def braked() -> MujocoPlant:
    """Three robots that hold the table by their brakes alone, some time after their agents have gone."""
    plant = MujocoPlant(build_world(scenario()))
    for arm in SEATS:
        plant.lose(arm)
    for _ in range(200):
        plant.read()
        plant.step()
    return plant


def exchange(plant: MujocoPlant, seats: dict[str, int]) -> None:
    model = build_world(plant.world.scenario, seats).model
    steps = with_robots(plant.world, seats, model)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            plant.move_to(end.value)
            return


def test_those_who_stay_feel_nothing_of_the_exchange() -> None:
    alone, joined = braked(), braked()
    exchange(joined, {**SEATS, "a4": 3})
    first = [plant.read() for plant in (alone, joined)]
    for arm in SEATS:
        np.testing.assert_array_equal(first[0][arm].q, first[1][arm].q, "the same senses, the same noise")
        np.testing.assert_array_equal(first[0][arm].qd, first[1][arm].qd)
        np.testing.assert_array_equal(first[0][arm].tau, first[1][arm].tau)
        # The wrist's force is solved for again, and the solver stops at a relative 1e-8 of some 100 N.
        np.testing.assert_allclose(first[0][arm].wrench, first[1][arm].wrench, rtol=0, atol=1e-3)
    for _ in range(100):
        for plant in (alone, joined):
            plant.read()
            plant.step()
    for name in ("a1", "a3"):
        q = [plant.world.data.qpos[plant.world.arms[name].arm_qpos] for plant in (alone, joined)]
        np.testing.assert_allclose(q[0], q[1], rtol=0, atol=1e-6)  # the same mechanics, solved in another order
    np.testing.assert_allclose(alone.load_pose().position, joined.load_pose().position, rtol=0, atol=1e-6)


def test_a_newcomer_stands_outside_braked_with_an_empty_hand() -> None:
    plant = braked()
    exchange(plant, {**SEATS, "a4": 3})
    start = plant.world.data.qpos[plant.world.arms["a4"].base_qpos].copy()
    for _ in range(300):
        reading = plant.read()["a4"]
        plant.step()
    np.testing.assert_allclose(plant.world.data.qpos[plant.world.arms["a4"].base_qpos], start, atol=1e-3)
    assert reading.grip_m == pytest.approx(0.08)
    assert not plant.hands.holds("a4")
    assert not plant.hands.is_held(3)
    assert plant.read()["a1"].odometry == (0.0,) * 6, "who carries is told no place"


def test_a_robot_that_has_gone_leaves_the_others_as_they_were() -> None:
    plant = braked()
    exchange(plant, {**SEATS, "a4": 3})
    plant.step()
    before = {name: plant.world.data.qpos[plant.world.arms[name].arm_qpos].copy() for name in SEATS}
    torque = {name: plant.read()[name].tau for name in SEATS}
    exchange(plant, {**SEATS, "a7": 4})
    assert plant.names == ["a1", "a2", "a3", "a7"]
    assert list(plant.met) == ["a1", "a2", "a3", "a4", "a7"]
    for name in SEATS:
        np.testing.assert_array_equal(plant.world.data.qpos[plant.world.arms[name].arm_qpos], before[name])
        np.testing.assert_allclose(plant.read()[name].tau, torque[name], atol=0.5)  # but for noise of 0.05 N m


def reach(plant: MujocoPlant, *, push_at: int = -1, seconds: float = 12.0) -> None:
    """Drive a4 to its strut by its own senses; at a tick, load and bearers are moved aside by 6 cm."""
    plant.regain("a4")
    doing = Reach(ArmModel("panda"), plant.reach("a4"))
    data = plant.world.data
    for tick in range(int(1000 * seconds)):
        reading = plant.read()["a4"]
        effort, grip_m = doing.step(np.array(reading.q), np.array(reading.qd), reading.grip_m, reading.odometry, 1e-3)
        plant.command("a4", effort.torque, effort.base_force, effort.stiffness, grip_m)
        if tick == push_at:
            data.qpos[plant.world.load_qpos.start] += 0.06
            for arm in SEATS:
                data.qpos[plant.world.arms[arm].base_qpos.start] += 0.06
                plant.lose(arm)  # the brakes hold where they are now
        plant.step()
        if doing.holds:
            return
    raise AssertionError(f"it is still about to {doing.phase}")


def test_a_reach_by_own_senses_takes_hold_where_the_hand_is_without_a_snap_and_again() -> None:
    plant = braked()
    exchange(plant, {**SEATS, "a4": 3})
    before = load_pose(plant.world)
    reach(plant)
    assert plant.hands.holds("a4")
    assert plant.hands.is_held(3)
    for _ in range(500):
        plant.read()
        plant.step()
    (closed,) = plant.hands.grasped
    # A weld switched on across a gap of 1 mm pulls with 2 kN.
    assert 0.0 < closed.force_max_N < 60.0
    assert np.linalg.norm(load_pose(plant.world).p - before.p) < 2e-3
    # It lets go, draws back, and takes hold again: where it stands now, by what it is told now.
    plant.slip("a4")
    for _ in range(2500):
        plant.read()
        plant.step()
    assert not plant.hands.holds("a4")
    reach(plant)
    assert plant.hands.is_held(3)
    assert np.linalg.norm(load_pose(plant.world).p - before.p) < 2e-3


def test_a_strut_that_has_moved_meanwhile_is_missed_and_that_is_said() -> None:
    plant = braked()
    exchange(plant, {**SEATS, "a4": 3})
    with pytest.raises(ReachFailed, match="closed on nothing"):
        reach(plant, push_at=1000)
    assert not plant.hands.holds("a4")


def test_a_plant_that_newcomers_have_come_to_goes_on_from_its_checkpoint_number_for_number() -> None:
    """One robot has come, another has come and gone, a hand is closing on nothing."""
    plant = braked()
    exchange(plant, {**SEATS, "a4": 3})
    plant.step()
    exchange(plant, {**SEATS, "a7": 4})
    plant.command("a7", np.zeros(7), np.zeros(3), np.zeros(7), 0.02)
    for _ in range(100):
        plant.read()
        plant.step()
    saved = pack(plant.state())
    other = MujocoPlant(build_world(scenario()))
    other.restore(unpack(saved))
    assert other.names == plant.names
    assert list(other.met) == list(plant.met)
    assert pack(other.state()) == saved
    for _ in range(50):
        assert other.read() == plant.read()
        for each in (plant, other):
            each.step()
    assert pack(other.state()) == pack(plant.state())


def test_a_world_that_cannot_be_built_is_one_sentence_and_leaves_nothing() -> None:
    plant = braked()
    build = Build(plant.world.scenario, {**SEATS, "a4": 99})
    with pytest.raises(NotBuilt, match=r"the world with a1, a2, a3, a4 could not be built: [^ ]"):
        build.world(plant.world)
    assert not build._folder.exists()
    assert build.advance(plant.world), "nothing more to wait for"
