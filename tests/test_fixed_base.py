"""An arm whose base is fixed: it is the arm alone, its base does not move by a bit, and nobody on the wire can tell."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from one_arm import HOME, OneArm
from plants import NO_STIFFNESS, QUIET, plant_of
from worlds import EXACT

from sim_server.faults.pushes import Push
from sim_server.mujoco_plant import MujocoPlant
from sim_server.newcomers import CannotCome, Newcomers
from sim_server.scenario import Scenario
from sim_server.snapshot import pack, unpack

BLOCK = {"shape": "block", "size_m": [0.1, 0.1, 0.1], "mass_kg": 2.5, "struts": 1}


def scenario(count: int = 1, load: dict[str, Any] = BLOCK, **sections: Any) -> Scenario:
    given = {"description": "test", "team": {"count": count}, "base": {"fixed": True}, "load": load, **sections}
    return Scenario.model_validate(given)


TABLE = {"mass_kg": 20.0}


def rows(plant: MujocoPlant, ticks: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Rows of the trace and where the arms' feet are, while the arms are driven and pushed about."""
    recorded, feet = [], []
    for tick in range(ticks):
        for name, reading in plant.read().items():
            swing = 2.0 * np.sin(0.02 * tick)
            plant.command(name, np.array(reading.tau) + swing, (900.0, -900.0, 150.0), NO_STIFFNESS)
        before = plant.state_row()
        plant.step()
        recorded.append(np.concatenate([part.ravel() for part in plant.force_row(before)]))
        feet.append([plant.world.data.xpos[ids.link0_body].copy() for ids in plant.world.arms.values()])
    return np.array(recorded), np.array(feet)


@pytest.mark.parametrize(("count", "load"), [(1, BLOCK), (4, TABLE)])
def test_a_fixed_base_does_not_move_by_a_bit_whatever_pushes_it(count: int, load: dict[str, Any]) -> None:
    plant = plant_of(scenario(count, load))
    plant.push(Push(at_s=0, kind="push", arm="a1", for_s=0.3, force_N=(100, 100, 0), torque_Nm=(0, 0, 10)))
    recorded, feet = rows(plant, 400)
    np.testing.assert_array_equal(feet, np.broadcast_to(feet[0], feet.shape))
    arms = recorded[:, 24:].reshape(400, count, -1)
    base, velocity, force = arms[:, :, 35:38], arms[:, :, 38:41], arms[:, :, 41:44]
    np.testing.assert_array_equal(base, np.broadcast_to(base[0], base.shape))
    np.testing.assert_array_equal(velocity, np.zeros_like(velocity))
    np.testing.assert_array_equal(force, np.zeros_like(force))  # what its agent commands, nothing exerts
    assert np.abs(arms[-1, 0, :7] - arms[0, 0, :7]).max() > 0.05  # the arm does move


def test_an_arm_on_a_fixed_base_is_that_arm_alone_in_mujoco() -> None:
    """Against the arm's description by itself, with a point mass at its tool: the same accelerations."""
    plant = plant_of(scenario(plant={**EXACT, **QUIET}, load={**BLOCK, "size_m": [0.01] * 3, "mass_kg": 2.5}))
    alone = OneArm(2.5)
    torque = np.array([1.0, 5.0, -2.0, 8.0, 0.5, 2.0, 0.3])
    data, ids = plant.world.data, plant.world.arms["a1"]
    np.testing.assert_array_equal(data.qpos[ids.arm_qpos], HOME)
    data.qfrc_applied[ids.arm_dof] = alone.data.qfrc_applied[:] = torque
    mujoco.mj_forward(plant.world.model, data)
    mujoco.mj_forward(alone.model, alone.data)
    # A weld is stiff, not rigid: by a thousandth of the acceleration.
    np.testing.assert_allclose(
        data.qacc[ids.arm_dof], alone.data.qacc, rtol=0, atol=2e-2 * np.abs(alone.data.qacc).max()
    )


def test_a_block_is_held_at_its_centre_of_mass_and_starts_at_rest() -> None:
    plant = plant_of(scenario())
    world, ids = plant.world, plant.world.arms["a1"]
    np.testing.assert_allclose(world.data.site_xpos[ids.tcp_site], world.data.xipos[world.load_body], atol=1e-12)
    for _ in range(100):
        plant.step()
    moved = plant.load_pose()
    assert np.linalg.norm(moved.linear_velocity) < 1e-3  # carried by the drivers' first torque
    assert world.load_mass == 2.5


def test_the_wire_does_not_tell_whether_a_base_is_fixed() -> None:
    fixed, rolling = (
        plant_of(scenario(plant={**QUIET, **EXACT}, base={"fixed": fixed})).read()["a1"] for fixed in (True, False)
    )
    assert fixed.odometry == rolling.odometry
    np.testing.assert_allclose(fixed.q, rolling.q, rtol=0, atol=0)
    np.testing.assert_allclose(fixed.tau, rolling.tau, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fixed.wrench, rolling.wrench, rtol=0, atol=0.2)  # a rolling base gives a little


def test_a_hand_that_slips_off_on_a_fixed_base_draws_back_and_feels_its_base_at_rest() -> None:
    plant = plant_of(scenario(4, TABLE))
    start = plant.world.data.site_xpos[plant.world.arms["a2"].tcp_site][2]
    plant.slip("a2")
    for _ in range(1500):
        plant.step()
    assert plant.world.data.site_xpos[plant.world.arms["a2"].tcp_site][2] > start + 0.1
    assert plant.read()["a2"].odometry == (0.0,) * 6


def test_two_plants_of_one_state_go_on_equally_on_fixed_bases() -> None:
    plant, other = plant_of(scenario()), plant_of(scenario())
    rows(plant, 40)
    other.restore(unpack(pack(plant.state())))
    np.testing.assert_array_equal(rows(plant, 40)[0], rows(other, 40)[0])


def test_nobody_comes_to_a_team_on_fixed_bases() -> None:
    given = scenario(3, {**TABLE, "struts": 4})
    newcomers = Newcomers(given, plant_of(given), None, lambda _: None, lambda _: None)  # type: ignore[arg-type]
    with pytest.raises(CannotCome, match="strut 4: the bases of this scenario are fixed"):
        newcomers.check(3, [])
