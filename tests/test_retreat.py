"""A robot that leaves: its share becomes the others', its hand opens when it bears nothing, and it drives clear."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from agents.controllers.interface import Sensed
from agents.reach import Reach
from agents.retreat import BACK_M, Phase, Retreat
from agents.safety import CheckedEffort, SafeController
from sim_server.grips import grip_wrenches
from sim_server.metrics import tilt_deg
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario import Scenario
from sim_server.unled_arms import Brake
from sim_server.world import build_world

Array = NDArray[np.float64]
DT_S = 0.001
LET_DOWN_S = 0.5
ARM = ArmModel("panda")


@dataclass
class Row:
    """What an onlooker sees at one tick."""

    phase: Phase
    force: Array
    """Of a2's hand on the load, (3,) N, world."""
    above_m: float
    """Hand above where it held, seen from the load's place."""
    aside_m: float
    """Hand off where it held, in the plane, likewise."""
    base: Array
    stiffness: Array
    holds: bool
    tilt_deg: float


@dataclass
class Watched:
    """A retreat of a2 from a team whose other arms are braked."""

    plant: MujocoPlant
    rows: list[Row] = field(default_factory=list)
    over: bool = False

    def of(self, *phases: Phase) -> list[Row]:
        return [row for row in self.rows if row.phase in phases]


def plant_of(**changes: Any) -> MujocoPlant:
    given: dict[str, Any] = {"description": "a test", "team": {"count": 4}, "load": {"mass_kg": 20.0}}
    plant = MujocoPlant(build_world(Scenario.model_validate(given | changes)))
    for name in ("a1", "a3", "a4"):
        plant._leave_to(name, Brake())
    return plant


def hand_off(plant: MujocoPlant) -> Array:
    """From the load's middle to a2's hand, (3,) m, world."""
    return np.array(plant._data.site_xpos[plant.world.arms["a2"].tcp_site]) - plant.load_pose().position


def watch(plant: MujocoPlant, carries_s: float = 0.3, seconds: float = 9.0) -> Watched:
    """Carry by the paper's law, then retreat; watch until it is over."""
    law = SafeController("paper", make_controller("paper", ARM, {}), ARM, 0.1)
    law.carry_at(plant.carry_height_m)
    retreat, watched = Retreat(ARM, LET_DOWN_S, holds=True), Watched(plant)
    at = hand_off(plant)
    for tick in range(round((carries_s + seconds) / DT_S)):
        reading = plant.read()["a2"]
        q, qd = np.array(reading.q), np.array(reading.qd)

        def wanted(q: Array = q, qd: Array = qd, reading: Any = reading) -> CheckedEffort:
            return law.step(Sensed(q, qd, np.array(reading.tau), np.array(reading.wrench)), DT_S)

        if tick * DT_S < carries_s:
            effort, grip_m = wanted(), 0.0
            at = hand_off(plant)
        else:
            effort, grip_m = retreat.step(wanted, q, qd, reading.grip_m, reading.odometry, DT_S)
        plant.command("a2", effort.torque, effort.base_force, effort.stiffness, grip_m)
        plant.step()
        if tick * DT_S < carries_s:
            continue
        off = hand_off(plant) - at
        watched.rows.append(
            Row(
                retreat.phase,
                grip_wrenches(plant.world)[1, :3].copy(),
                float(off[2]),
                float(np.hypot(off[0], off[1])),
                plant._data.qpos[plant.world.arms["a2"].base_qpos].copy(),
                np.array(effort.stiffness),
                plant.hands.holds("a2"),
                float(tilt_deg(plant.load_pose().quat_wxyz[None])[0]),
            )
        )
        if retreat.is_over:
            watched.over = True
            break
    return watched


@pytest.fixture(scope="module")
def watched() -> Watched:
    return watch(plant_of())


def test_the_share_and_the_stiffness_fade_before_the_hand_opens(watched: Watched) -> None:
    down = watched.of(Phase.LET_DOWN)
    assert len(down) == pytest.approx(LET_DOWN_S / DT_S, abs=1)
    assert all(row.holds for row in down)
    lift = np.array([row.force[2] for row in down])
    assert lift[0] > 20.0  # of 196 N; how four arms share a load, three of them rigid, is not determined
    assert abs(lift[-1]) < 5.0
    blocks = lift[: len(lift) // 10 * 10].reshape(10, -1).mean(axis=1)
    assert (np.diff(blocks) < 2.0).all()  # never up again by more than friction makes it stick
    stiff = np.array([row.stiffness.sum() for row in down])
    assert stiff[-1] < 0.01 * stiff[0]


def test_the_hand_opens_once_and_then_exerts_nothing(watched: Watched) -> None:
    after = watched.of(Phase.OPEN, Phase.LIFT, Phase.DRIVE, Phase.CLEAR)
    assert watched.plant.hands.opened == ["a2"]
    assert not any(row.holds for row in after[2:])
    np.testing.assert_array_equal(np.array([row.force for row in after[2:]]), 0.0)


def test_the_hand_is_off_the_strut_before_it_moves_aside(watched: Watched) -> None:
    """A strut is 3 cm high and the open fingers leave it 2.5 cm on either side."""
    for row in watched.of(Phase.OPEN, Phase.LIFT):
        assert row.above_m > -0.01
        assert row.aside_m < 0.025
    assert all(row.above_m > 0.08 for row in watched.of(Phase.DRIVE))


def test_the_robot_ends_at_rest_a_metre_clear_and_the_load_hardly_feels_it(watched: Watched) -> None:
    assert watched.over
    moved = watched.rows[-1].base - watched.rows[0].base
    assert 1.1 < float(np.hypot(*moved[:2])) < BACK_M + 0.05
    fastest = np.abs(np.diff([row.base[:2] for row in watched.rows[-20:]], axis=0)).max() / DT_S
    assert fastest < 0.1
    assert max(row.tilt_deg for row in watched.rows) < 1.0


def test_after_its_goodbye_it_stays_where_it_stands(watched: Watched) -> None:
    plant = watched.plant
    ids = plant.world.arms["a2"]
    plant.let_down("a2", retreated=True)
    q, base = plant._data.qpos[ids.arm_qpos].copy(), plant._data.qpos[ids.base_qpos].copy()
    for _ in range(3000):
        plant.step()
    np.testing.assert_allclose(plant._data.qpos[ids.arm_qpos], q, atol=0.05)
    np.testing.assert_allclose(plant._data.qpos[ids.base_qpos], base, atol=0.02)


def test_a_hand_that_still_holds_at_a_goodbye_is_let_down_by_its_driver_all_the_same() -> None:
    plant = plant_of(team={"count": 4, "leave_s": 0.1})
    plant.let_down("a2", retreated=True)
    for _ in range(150):
        plant.step()
    assert not plant.hands.holds("a2")


def test_a_load_that_moves_on_is_not_hit_by_the_hand_that_leaves_it() -> None:
    """All bases roll together at 0.2 m/s, so the strut goes on while the hand is lifted."""
    plant = plant_of()
    data = plant.world.data
    for ids in plant.world.arms.values():
        data.qvel[ids.base_dof] = 0.2, 0.0, 0.0
    data.qvel[plant.world.load_dof.start] = 0.2
    for name in ("a1", "a3", "a4"):
        plant._leave_to(name, Rolling())
    seen = watch(plant)
    assert seen.over
    low = [row for row in seen.of(Phase.OPEN, Phase.LIFT) if row.above_m < 0.04]
    assert max(row.aside_m for row in low) < 0.025


class Rolling(Brake):
    """Braked joints on a base that is driven along the world's x at 0.2 m/s."""

    def step(self, felt: Any, torque: Array, dt_s: float) -> tuple[Array, Array]:
        wanted, _ = super().step(felt, torque, dt_s)
        return wanted, felt.in_base(20_000.0 * (np.array([0.2, 0.0, 0.0]) - felt.base_rate))


@pytest.mark.parametrize("after_s", [0.2, 3.0])
def test_a_robot_that_still_reaches_turns_back_with_an_empty_hand(after_s: float) -> None:
    plant = plant_of()
    plant.slip("a2")
    for _ in range(2500):
        plant.read()
        plant.step()
    plant.regain("a2")
    reach: Reach | None = Reach(ARM, plant.reach("a2"))
    retreat = Retreat(ARM, LET_DOWN_S, holds=False)
    plant.hands.opened.clear()
    start = plant._data.qpos[plant.world.arms["a2"].base_qpos].copy()
    for tick in range(round((after_s + 8.0) / DT_S)):
        reading = plant.read()["a2"]
        senses = np.array(reading.q), np.array(reading.qd), reading.grip_m, reading.odometry, DT_S
        if tick * DT_S >= after_s:
            reach = None
            effort, grip_m = retreat.step(_nothing, *senses)
        elif reach is not None:
            effort, grip_m = reach.step(*senses)
            assert not reach.holds
        plant.command("a2", effort.torque, effort.base_force, effort.stiffness, grip_m)
        plant.step()
        if retreat.is_over:
            break
    assert retreat.phase is Phase.CLEAR
    assert not plant.hands.holds("a2")
    moved = plant._data.qpos[plant.world.arms["a2"].base_qpos] - start
    assert float(np.hypot(*moved[:2])) > 1.0


def _nothing() -> CheckedEffort:
    raise AssertionError("an empty hand's law is not asked")


def test_a_retreat_that_gets_nowhere_ends_all_the_same() -> None:
    """An arm whose grasp has failed obeys nobody: its driver keeps it, and the goodbye must not wait for ever."""
    retreat = Retreat(ARM, 0.0, holds=True)
    q = np.array([0.0, -0.1, 0.0, -2.1, 0.0, 2.0, 0.785])
    for _ in range(200):
        assert not retreat.is_over
        retreat.step(_nothing, q, np.zeros(7), 0.03, (0.0,) * 6, 0.1)
    retreat.step(_nothing, q, np.zeros(7), 0.03, (0.0,) * 6, 0.1)
    assert retreat.is_over
