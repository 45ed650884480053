"""The simulated world against laws of mechanics, Pinocchio, and sums done by hand."""

from __future__ import annotations

from functools import cache
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from sim_server.differences import draw_differences
from sim_server.grips import grip_wrenches
from sim_server.layout import LayoutError, Pose
from sim_server.loads import load_body
from sim_server.parts import MEETS, Touch
from sim_server.robots import CARRY_HEIGHT_M, PEDESTAL_MIN_M, NoHome
from sim_server.scenario import Load, Plant, Scenario
from sim_server.world import World, build_world
from wire.arms import arm_path

GRAVITY = 9.81
EXACT = {"link_mass_error": 0, "joint_damping_Nms_rad": 0, "joint_friction_Nm": 0}
TABLES = {1: (0.4, 0.4, 0.3), 2: (1.6, 0.9, 0.75), 4: (1.6, 0.9, 0.75), 6: (2.4, 1.0, 0.75), 16: (4.0, 2.0, 0.75)}


def scenario(count: int = 4, *, plant: dict[str, Any] | None = None, seed: int = 1, **load: Any) -> Scenario:
    """A team at the load of its size, one strut per arm unless told otherwise."""
    shape = "crate" if count == 1 else "table"
    given = {"shape": shape, "size_m": TABLES.get(count, TABLES[4]), "struts": count, "mass_kg": 5.0 * count, **load}
    return Scenario.model_validate(
        {"description": "test", "seed": seed, "team": {"count": count}, "load": given, "plant": plant or {}}
    )


def hold(world: World, seconds: float) -> None:
    """Joints and bases on springs to where they are, gravity of the arms compensated; step for a time."""
    model, data = world.model, world.data
    start = data.qpos.copy()
    for _ in range(round(seconds / model.opt.timestep)):
        for ids in world.arms.values():
            for qpos, dof, stiffness, damping in (
                (ids.arm_qpos, ids.arm_dof, 600.0, 40.0),
                (ids.base_qpos, ids.base_dof, 5000.0, 1000.0),
            ):
                error = start[qpos] - data.qpos[qpos]
                force = data.qfrc_bias[dof] + stiffness * error - damping * data.qvel[dof]
                data.qfrc_applied[dof] = force
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)


@cache
def held() -> World:
    """Four arms that have held the standard table, its weight off the middle, until nothing moves any more."""
    world = build_world(scenario(4, plant=EXACT, mass_kg=20.0, centre_of_mass_offset_m=(0.15, -0.05, 0.02)))
    hold(world, 2.0)
    return world


def load_motion(world: World) -> tuple[Any, Any, Any, Any]:
    """Centre of mass, its acceleration, angular velocity, angular acceleration of the load, world axes."""
    data = world.data
    R_WO = data.xmat[world.load_body].reshape(3, 3)
    linear, angular = data.qacc[world.load_dof][:3], R_WO @ data.qacc[world.load_dof][3:]
    omega = R_WO @ data.qvel[world.load_dof][3:]
    r = R_WO @ world.load_com
    return (
        data.xpos[world.load_body] + r,
        linear + np.cross(angular, r) + np.cross(omega, np.cross(omega, r)),
        omega,
        angular,
    )


def moment_about(point: Any, wrenches: Any, world: World) -> Any:
    grasps = np.array([world.data.site_xpos[ids.grasp_site] for ids in world.arms.values()])
    return (wrenches[:, 3:] + np.cross(grasps - point, wrenches[:, :3])).sum(axis=0)


def tree_mass_matrix(world: World) -> Any:
    M = np.zeros((world.model.nv, world.model.nv))
    mujoco.mj_fullM(world.model, world.data, M)
    return M


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


# The arm in the world


def test_without_differences_the_arm_in_the_world_is_pinocchios_arm() -> None:
    world = build_world(scenario(4, plant=EXACT))
    model = pin.buildModelFromMJCF(str(arm_path("panda")))
    data = model.createData()
    M_all = tree_mass_matrix(world)
    for ids in world.arms.values():
        M = np.triu(pin.crba(model, data, world.q_home))
        M = M + np.triu(M, 1).T
        # Rounding only: the standing base shares no term with the arm's own block.
        np.testing.assert_allclose(M_all[ids.arm_dof, ids.arm_dof], M, rtol=0, atol=1e-13)
        gravity = pin.computeGeneralizedGravity(model, data, world.q_home)
        np.testing.assert_allclose(world.data.qfrc_bias[ids.arm_dof], gravity, rtol=0, atol=1e-12)
        assert not world.model.dof_damping[ids.arm_dof].any()
        assert not world.model.dof_frictionloss[ids.arm_dof].any()


def test_drawn_differences_are_what_the_arm_in_the_world_has() -> None:
    plant = {"link_mass_error": 0.2, "joint_damping_Nms_rad": 0.5, "joint_friction_Nm": 0.2}
    exact, world = build_world(scenario(4, plant=EXACT)), build_world(scenario(4, plant=plant))
    for ids in world.arms.values():
        drawn = ids.differences
        np.testing.assert_array_equal(world.model.dof_damping[ids.arm_dof], drawn.joint_damping)
        np.testing.assert_array_equal(world.model.dof_frictionloss[ids.arm_dof], drawn.joint_friction)
        bodies = [world.model.body(f"{ids.name}/{link}").id for link in (*(f"link{k}" for k in range(1, 8)), "hand")]
        for field in ("body_mass", "body_inertia"):
            ratio = getattr(world.model, field)[bodies].T / getattr(exact.model, field)[bodies].T
            # Rounding, and that of diagonalising an inertia of 1e-3 to 1e-16.
            np.testing.assert_allclose(ratio, np.broadcast_to(drawn.link_scale, ratio.shape), rtol=1e-10)
        np.testing.assert_allclose(
            world.model.body_ipos[bodies], exact.model.body_ipos[bodies], rtol=0, atol=0
        )  # centres of mass stay


def test_differences_depend_on_seed_and_arm_only_and_stay_in_their_bounds() -> None:
    plant = Plant(link_mass_error=0.1, joint_damping_Nms_rad=0.4, joint_friction_Nm=0.2)
    first, again, other_arm, other_seed = (draw_differences(plant, *key) for key in ((3, 0), (3, 0), (3, 1), (4, 0)))
    for name, low, high in (("link_scale", 0.9, 1.1), ("joint_damping", 0.2, 0.6), ("joint_friction", 0.1, 0.3)):
        drawn = getattr(first, name)
        np.testing.assert_array_equal(drawn, getattr(again, name))
        assert ((drawn >= low) & (drawn <= high)).all()
        assert not np.isin(drawn, getattr(other_arm, name)).any()
        assert not np.isin(drawn, getattr(other_seed, name)).any()


def test_switching_one_difference_off_leaves_the_others_as_they_were() -> None:
    both, one = draw_differences(Plant(), 1, 0), draw_differences(Plant(link_mass_error=0), 1, 0)
    np.testing.assert_array_equal(one.link_scale, np.ones(8))
    np.testing.assert_array_equal(one.joint_damping, both.joint_damping)
    np.testing.assert_array_equal(one.joint_friction, both.joint_friction)


# The load


def test_crate_with_its_handle_has_the_inertia_done_by_hand() -> None:
    body = load_body(Load(shape="crate", size_m=(0.4, 0.4, 0.3), mass_kg=2.5, struts=1)).inertia
    # Box, bar 180 x 30 x 30 mm at 0.36 m, two posts 30 x 30 x 45 mm at x = -+75 mm and 0.3225 m: volumes in litres.
    box, bar, post = 48.0, 0.162, 0.0405
    per_litre = 2.5 / (box + bar + 2 * post)
    z = (box * 0.15 + bar * 0.36 + 2 * post * 0.3225) / (box + bar + 2 * post)
    izz = per_litre * (
        box * (0.4**2 + 0.4**2) / 12 + bar * (0.18**2 + 0.03**2) / 12 + 2 * post * (2 * 0.03**2 / 12 + 0.075**2)
    )
    ixx = per_litre * (
        box * ((0.4**2 + 0.3**2) / 12 + (z - 0.15) ** 2)
        + bar * (2 * 0.03**2 / 12 + (z - 0.36) ** 2)
        + 2 * post * ((0.03**2 + 0.045**2) / 12 + (z - 0.3225) ** 2)
    )
    np.testing.assert_allclose(body.com, [0, 0, z], rtol=0, atol=1e-15)
    assert body.I[2, 2] == pytest.approx(izz, rel=1e-12)  # rounding
    assert body.I[0, 0] == pytest.approx(ixx, rel=1e-12)
    np.testing.assert_allclose(body.I - np.diag(np.diag(body.I)), 0, atol=1e-15)


def rotation(quat_wxyz: Any) -> Any:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quat_wxyz)
    return R.reshape(3, 3)


def mujocos_inertia(world: World) -> tuple[Any, Any]:
    """Centre of mass and inertia in O's axes of the load's shapes at one density, as MuJoCo makes them from geoms."""
    spec, model = mujoco.MjSpec(), world.model
    body = spec.worldbody.add_body()
    geoms = np.flatnonzero(model.geom_bodyid == world.load_body)
    volume = np.prod(2 * model.geom_size[geoms], axis=1).sum()
    for g in geoms:
        body.add_geom(
            type=model.geom_type[g],
            size=model.geom_size[g],
            pos=model.geom_pos[g],
            quat=model.geom_quat[g],
            density=world.load_mass / volume,
        )
    alone = spec.compile()
    R = rotation(alone.body_iquat[1])
    return alone.body_ipos[1], R @ np.diag(alone.body_inertia[1]) @ R.T


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.05)])
@pytest.mark.parametrize(("shape", "struts"), [("table", 5), ("crate", 3), ("table", 4)])
def test_a_load_has_exactly_its_mass_and_the_inertia_of_its_parts_and_the_offset(
    shape: str, struts: int, offset: tuple[float, float, float]
) -> None:
    world = build_world(scenario(2, shape=shape, struts=struts, mass_kg=23.0, centre_of_mass_offset_m=offset))
    model, body = world.model, world.load_body
    com, inertia = mujocos_inertia(world)
    R = rotation(model.body_iquat[body])
    assert model.body_mass[body] == 23.0
    assert model.body_subtreemass[body] == 23.0
    # MuJoCo adds up quaternion-rotated parts and diagonalises: rounding of kg m^2 of order 10.
    np.testing.assert_allclose(model.body_ipos[body], com + offset, rtol=0, atol=1e-12)
    np.testing.assert_allclose(world.load_com, com + offset, rtol=0, atol=1e-12)
    np.testing.assert_allclose(R @ np.diag(model.body_inertia[body]) @ R.T, inertia, rtol=0, atol=1e-11)


def test_named_points_lie_on_the_rim_at_the_struts_level() -> None:
    world = build_world(scenario(4))
    z = 0.75 - 0.03 - 0.015
    expected = {"centre": (0, 0), "front": (0.8, 0), "back": (-0.8, 0), "left": (0, 0.45), "right": (0, -0.45)}
    assert world.load_points.keys() == expected.keys()
    for name, point in world.load_points.items():
        np.testing.assert_allclose(point, [*expected[name], z], atol=1e-15)


def test_a_load_that_all_let_go_of_stands_on_its_legs() -> None:
    world = build_world(scenario(4, plant=EXACT))
    world.data.eq_active[:] = 0
    hold(world, 1.0)
    assert abs(world.data.qpos[world.load_qpos][2]) < 2e-3  # MuJoCo's contacts give by about a millimetre
    assert abs(world.data.qvel[world.load_dof]).max() < 1e-2
    assert not grip_wrenches(world).any()


def test_contact_classes_meet_each_other_or_not_at_all() -> None:
    for a in Touch:
        for b in Touch:
            assert bool(MEETS[a] & b) == bool(MEETS[b] & a)


def test_a_base_does_not_drive_through_a_leg() -> None:
    world = build_world(scenario(4, plant=EXACT))
    data, base, load = world.data, world.arms["a1"].base_body, world.load_body
    data.qpos[world.arms["a1"].base_qpos] = 0.8 - 0.08, 0.45 - 0.08 + 0.28, -np.pi / 2  # its front 2 cm into a leg
    mujoco.mj_forward(world.model, data)
    pairs = {frozenset(world.model.geom_bodyid[contact.geom]) for contact in data.contact}
    assert frozenset({base, load}) in pairs


# What the hands exert


def test_held_still_the_hands_carry_the_weight_and_no_moment_is_left() -> None:
    world = held()
    weight = 20.0 * GRAVITY
    wrenches = grip_wrenches(world)
    com, *_ = load_motion(world)
    # What still moves after two seconds: accelerations below 1e-5, so forces below 1e-3 N on 20 kg.
    np.testing.assert_allclose(wrenches[:, :3].sum(axis=0), [0, 0, weight], rtol=0, atol=1e-3)
    np.testing.assert_allclose(moment_about(com, wrenches, world), 0, atol=1e-3)
    # The weight is forward and to the right of the middle: a4 stands there, a3 opposite.
    share = dict(zip(world.arms, wrenches[:, 2], strict=True))
    assert share["a4"] == max(share.values())
    assert share["a3"] == min(share.values())


def test_a_grip_is_the_wrist_sensor_without_the_weight_of_the_hand() -> None:
    world = held()
    model, data = world.model, world.data
    for ids, grip in zip(world.arms.values(), grip_wrenches(world), strict=True):
        R = data.site_xmat[ids.wrist_site].reshape(3, 3)
        hand_weight = np.array([0, 0, -GRAVITY * model.body_subtreemass[ids.hand_body]])
        lever = data.subtree_com[ids.hand_body] - data.site_xpos[ids.wrist_site]
        force = R @ data.sensordata[ids.force_sensor] + hand_weight
        torque = R @ data.sensordata[ids.torque_sensor] + np.cross(lever, hand_weight)
        arm = data.site_xpos[ids.grasp_site] - data.site_xpos[ids.wrist_site]
        # A hand of 0.76 kg that still moves a little; see above.
        np.testing.assert_allclose(force, grip[:3], rtol=0, atol=1e-4)
        np.testing.assert_allclose(torque, grip[3:] + np.cross(arm, grip[:3]), rtol=0, atol=1e-4)


@pytest.mark.parametrize("jacobian", ["mjJAC_DENSE", "mjJAC_SPARSE"])
@pytest.mark.parametrize("count", [1, 4, 6])
def test_grips_and_weight_are_what_accelerates_the_load(jacobian: str, count: int) -> None:
    """Newton and Euler, on a load that turns and swings, with one grasp lost: no term may be missing or doubled."""
    world = build_world(scenario(count, plant=EXACT, centre_of_mass_offset_m=(0.03, 0.02, 0.01)))
    model, data = world.model, world.data
    model.opt.jacobian = getattr(mujoco.mjtJacobian, jacobian)
    model.opt.tolerance, model.opt.iterations = 1e-14, 200
    rng = np.random.default_rng(5)
    if count > 1:
        data.eq_active[world.arms["a2"].weld] = 0
    data.qvel[world.load_dof] = [0.3, -0.2, 0.1, 0.9, -0.7, 0.8]
    data.qfrc_applied[:] = rng.normal(scale=20.0, size=model.nv)
    data.qfrc_applied[world.load_dof] = 0
    for _ in range(20):  # away from the start's special angles
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    assert mujoco.mj_isSparse(model) == (jacobian == "mjJAC_SPARSE")

    wrenches = grip_wrenches(world)
    com, acceleration, omega, alpha = load_motion(world)
    R = data.ximat[world.load_body].reshape(3, 3)
    I = R @ np.diag(model.body_inertia[world.load_body]) @ R.T
    mass = world.load_mass
    # The solver's own remainder, against forces of hundreds of N.
    np.testing.assert_allclose(
        wrenches[:, :3].sum(axis=0), mass * (acceleration - model.opt.gravity), rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(
        moment_about(com, wrenches, world), I @ alpha + np.cross(omega, I @ omega), rtol=0, atol=1e-6
    )
    assert np.linalg.norm(wrenches[0]) > 1
    if count > 1:
        assert not wrenches[1].any()
