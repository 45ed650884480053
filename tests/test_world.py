"""The simulated world at its start: hands, bases and pedestals are where the scenario puts them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from worlds import hold, scenario

from sim_server.layout import LayoutError, Pose
from sim_server.robots import CARRY_HEIGHT_M, PEDESTAL_MIN_M, NoHome
from sim_server.scenario import Scenario
from sim_server.world import build_world

# The start


@pytest.mark.parametrize("count", [1, 2, 4, 6, 16])
def test_every_hand_starts_exactly_on_its_strut_and_nothing_touches(count: int) -> None:
    world = build_world(scenario(count))
    data = world.data
    assert list(world.arms) == [f"a{k}" for k in range(1, count + 1)]
    for ids in world.arms.values():
        # Rounding of the kinematic chain, metres from the origin.
        np.testing.assert_allclose(data.site_xpos[ids.tcp_site], data.site_xpos[ids.grasp_site], rtol=0, atol=1e-13)
        np.testing.assert_allclose(data.site_xmat[ids.tcp_site], data.site_xmat[ids.grasp_site], rtol=0, atol=1e-13)
        R_WE = data.site_xmat[ids.tcp_site].reshape(3, 3)
        outward = data.xmat[world.load_body].reshape(3, 3) @ world.struts[ids.strut].R[:, 0]
        np.testing.assert_allclose(R_WE[:, 2], [0, 0, -1], atol=1e-12)  # approach from above
        np.testing.assert_allclose(R_WE[:, 1] @ outward, 0, atol=1e-12)  # fingers close across the strut
        R_WB = data.xmat[ids.base_body].reshape(3, 3)
        np.testing.assert_allclose(R_WB[:, 0], -outward, atol=1e-12)  # the robot faces the load
    assert data.ncon == 0
    assert not data.qvel.any()


def test_the_standard_table_is_carried_ten_centimetres_up_and_a_low_crate_higher() -> None:
    table, crate = build_world(scenario(4)), build_world(scenario(1))
    assert table.X_WO_start.p[2] == pytest.approx(CARRY_HEIGHT_M, abs=1e-12)
    assert 0.25 < table.pedestal_m < 0.5
    assert crate.pedestal_m == PEDESTAL_MIN_M
    assert crate.X_WO_start.p[2] > CARRY_HEIGHT_M


def test_a_load_too_high_for_the_pedestal_is_refused_with_its_key() -> None:
    with pytest.raises(LayoutError, match=r"load\.size_m.*pedestal of 1\.\d+ m.*at most 0\.8 m"):
        build_world(scenario(4, size_m=(1.6, 0.9, 1.5)))


def test_an_arm_without_a_starting_posture_is_refused_with_those_that_have_one() -> None:
    other = scenario(4).model_copy(update={"team": scenario(4).team.model_copy(update={"arm": "nobody"})})
    with pytest.raises(NoHome, match="panda"):
        build_world(other)


def test_the_home_posture_keeps_away_from_limits() -> None:
    world = build_world(scenario(1))
    limits = world.arms["a1"].position_limit
    assert (np.minimum(world.q_home - limits[:, 0], limits[:, 1] - world.q_home) > 0.8).all()


def test_base_coordinates_are_the_pose_in_the_world_whatever_the_heading() -> None:
    world = build_world(scenario(4))
    data, ids = world.data, world.arms["a2"]
    data.qpos[ids.base_qpos] = 1.0, -2.0, 0.6
    data.qvel[ids.base_dof] = 0.3, 0.0, 0.0
    mujoco.mj_forward(world.model, data)
    np.testing.assert_allclose(data.xpos[ids.base_body], [1, -2, 0], atol=1e-15)
    np.testing.assert_allclose(data.xmat[ids.base_body].reshape(3, 3), Pose.planar(0, 0, yaw=0.6).R, atol=1e-15)
    J = np.zeros((3, world.model.nv))
    mujoco.mj_jacBody(world.model, data, J, None, ids.base_body)
    np.testing.assert_allclose(J @ data.qvel, [0.3, 0, 0], atol=1e-15)


def test_step_and_base_are_those_of_the_scenario() -> None:
    base = {"mass_kg": 70.0, "yaw_inertia_kg_m2": 4.0, "rolling_resistance_Ns_m": 500.0, "yaw_resistance_Nms_rad": 50.0}
    given = scenario(4, plant={"physics_step_ms": 1}).model_dump() | {"base": base}
    world = build_world(Scenario.model_validate(given))
    assert world.model.opt.timestep == 0.001
    for ids in world.arms.values():
        np.testing.assert_array_equal(world.model.dof_damping[ids.base_dof], [500.0, 500.0, 50.0])
        assert world.model.body_mass[ids.base_body] == 70.0
        assert world.model.body_inertia[ids.base_body].max() == 4.0  # MuJoCo sorts them; yaw's is the largest


def test_the_same_scenario_gives_the_same_world_bit_for_bit() -> None:
    first, second = (build_world(scenario(4)) for _ in range(2))
    for world in (first, second):
        hold(world, 0.05)
    assert first.data.qpos.tobytes() == second.data.qpos.tobytes()
