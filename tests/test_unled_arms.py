"""What motor drivers do by themselves: no bump at the start, hold, fade, open, stop; on a plain model and in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_server.metrics import tilt_deg
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario_files import load_scenario
from sim_server.unled_arms import Brake, Felt, FeltByOne, LetDown, Limp, Release, smooth
from sim_server.world import build_world

Array = NDArray[np.float64]
DT_S = 0.001
GRAVITY = np.array([0.0, -20.0, 1.0, 15.0, 0.5, 2.0, 0.0])
numbers = st.lists(st.floats(-80, 80), min_size=7, max_size=7).map(np.array)


def at_rest(q: Array | None = None, yaw: float = 0.0, base_rate: tuple[float, float, float] = (0, 0, 0)) -> FeltByOne:
    still = np.zeros(7)
    return FeltByOne(GRAVITY, still if q is None else q, still, np.array([1.0, 2.0, yaw]), np.array(base_rate, float))


@given(numbers)
def test_an_arm_that_is_braked_or_let_down_at_rest_starts_with_the_torque_it_had(torque: Array) -> None:
    for behaviour in (Brake(), LetDown(2.0)):
        wanted, _ = behaviour.step(at_rest(), torque, DT_S)
        np.testing.assert_allclose(wanted, torque, rtol=0, atol=1e-12)  # two additions of numbers below 100


@given(numbers)
def test_an_arm_that_is_limp_or_has_opened_its_hand_at_rest_bears_only_itself(torque: Array) -> None:
    for behaviour in (Limp(), Release()):
        wanted, force = behaviour.step(at_rest(), torque, DT_S)
        np.testing.assert_array_equal(wanted, GRAVITY)
        np.testing.assert_array_equal(force, 0.0)


@given(numbers)
def test_what_an_arm_bore_only_ever_fades_while_it_is_let_down_and_then_the_hand_opens(torque: Array) -> None:
    behaviour, borne = LetDown(0.05), np.abs(torque - GRAVITY)
    for _ in range(50):
        assert behaviour.holds
        wanted, _ = behaviour.step(at_rest(), torque, DT_S)
        assert (np.abs(wanted - GRAVITY) <= borne + 1e-12).all()
        borne = np.abs(wanted - GRAVITY)
    assert (borne <= 0.002 * np.abs(torque - GRAVITY) + 1e-12).all()  # 1 - smooth(49/50) = 0.0012
    assert not behaviour.holds


@given(st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1))
def test_a_base_that_stops_is_pushed_against_its_motion_in_its_own_axes(yaw: float, vx: float, vy: float) -> None:
    _, force = Release().step(at_rest(yaw=yaw, base_rate=(vx, vy, 0.0)), GRAVITY, DT_S)
    c, s = np.cos(yaw), np.sin(yaw)
    power = (c * force[0] - s * force[1]) * vx + (s * force[0] + c * force[1]) * vy
    assert power == pytest.approx(-2000.0 * (vx * vx + vy * vy), abs=1e-9)


@given(st.floats(-1, 2), st.floats(-1, 2))
def test_smooth_rises_from_0_to_1(a: float, b: float) -> None:
    low, high = sorted((smooth(a), smooth(b)))
    assert 0.0 <= low <= high <= 1.0
    assert (a <= b) == (smooth(a) <= smooth(b)) or smooth(a) == smooth(b)


def plant_of(**team: object) -> MujocoPlant:
    """`hold`, in which nobody commands the arms of a table that is held by brakes."""
    return MujocoPlant(build_world(load_scenario("hold", {"team": team}).scenario))


def hold_all(plant: MujocoPlant, *but: str) -> None:
    """Brake every arm but those, whatever the scenario says: bearers that need no agent."""
    for name in plant.world.arms:
        if name not in but:
            plant._leave_to(name, Brake())


def run(plant: MujocoPlant, seconds: float) -> float:
    """Steps; the worst tilt meanwhile."""
    worst = 0.0
    for _ in range(round(seconds * 1000)):
        plant.step()
        worst = max(worst, float(tilt_deg(plant.load_pose().quat_wxyz[None])[0]))
    return worst


def hand(plant: MujocoPlant, arm: str) -> Array:
    return np.array(plant._data.site_xpos[plant.world.arms[arm].tcp_site])


def holds(plant: MujocoPlant, arm: str) -> bool:
    return bool(plant._data.eq_active[plant.world.arms[arm].weld])


def test_a_lost_arm_that_releases_draws_up_and_back_smoothly_and_its_base_stands() -> None:
    plant = plant_of(when_lost="release")
    hold_all(plant, "a2")
    before, base = hand(plant, "a2"), plant._data.qpos[plant.world.arms["a2"].base_qpos].copy()
    plant.lose("a2")
    fastest, last = 0.0, before
    for _ in range(2500):
        plant.step()
        now = hand(plant, "a2")
        fastest, last = max(fastest, float(np.linalg.norm(now - last)) / DT_S), now
    assert plant.hands.opened == ["a2"]
    assert not holds(plant, "a2")
    assert 0.15 < last[2] - before[2] < 0.35
    assert fastest < 0.5  # no teleport: 0.25 m in 2 s, and what the freed arm springs by
    moved = plant._data.qpos[plant.world.arms["a2"].base_qpos] - base
    assert np.abs(moved[:2]).max() < 0.05


def test_an_arm_that_leaves_lets_its_share_down_before_its_hand_opens_and_drives_clear() -> None:
    plant = plant_of(leave_s=1.0)
    hold_all(plant, "a2")
    base = plant._data.qpos[plant.world.arms["a2"].base_qpos].copy()
    plant.let_down("a2")
    run(plant, 0.99)
    assert holds(plant, "a2")
    run(plant, 0.02)
    assert not holds(plant, "a2")
    assert run(plant, 6.0) < 2.0
    moved = plant._data.qpos[plant.world.arms["a2"].base_qpos] - base
    # 1.2 m, less the slip of a velocity drive against resistance: out of the way of a neighbour's base that follows.
    assert 0.8 < float(np.linalg.norm(moved[:2])) < 1.3


def test_braked_arms_hold_the_table_where_it_is() -> None:
    plant = plant_of(when_lost="brake")
    for name in plant.world.arms:
        plant.lose(name)
    start = plant.load_pose().position.copy()
    assert run(plant, 1.0) < 0.5
    assert np.abs(plant.load_pose().position - start).max() < 0.005


def test_a_grasp_that_fails_is_drawn_from_the_seed_and_ends_for_good() -> None:
    def shaken(seed: int) -> tuple[list[float], MujocoPlant]:
        plant = MujocoPlant(build_world(load_scenario("hold", {"seed": seed}).scenario))
        hold_all(plant)
        plant.loosen("a2", 20.0)
        run(plant, 0.2)
        return plant.load_pose().position.tolist(), plant

    first, plant = shaken(1)
    assert first == shaken(1)[0]
    assert first != shaken(2)[0]
    plant.slip("a2")
    plant.step()
    assert not holds(plant, "a2")
    np.testing.assert_array_equal(plant._data.xfrc_applied[plant.world.arms["a2"].hand_body], 0.0)


def test_felt_of_one_arm_is_its_row() -> None:
    rows = np.arange(14.0).reshape(2, 7)
    three = np.arange(6.0).reshape(2, 3)
    one = Felt(rows, rows + 1, rows + 2, three, three + 1).of(1)
    np.testing.assert_array_equal(one.qd, rows[1] + 2)
    np.testing.assert_array_equal(one.base_rate, three[1] + 1)
