"""The arm in the world is Pinocchio's arm but for the differences that were drawn for it."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from worlds import EXACT, scenario

from sim_server.differences import draw_differences
from sim_server.scenario import Plant
from sim_server.world import World, build_world
from wire.arms import arm_path


def tree_mass_matrix(world: World) -> Any:
    M = np.zeros((world.model.nv, world.model.nv))
    mujoco.mj_fullM(world.model, world.data, M)
    return M


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
