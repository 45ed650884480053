"""What the hands exert on the load, against Newton and Euler and the wrist sensors."""

from __future__ import annotations

from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from worlds import EXACT, hold, scenario

from sim_server.grips import grip_wrenches
from sim_server.world import World, build_world

GRAVITY = 9.81


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
