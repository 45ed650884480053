"""From one world to another that has other robots: what both have goes on as it was, to the last number."""

from __future__ import annotations

from typing import Any

from sim_server.grasping import base_at_strut
from sim_server.layout import Pose
from sim_server.world import World

OUTSIDE_M = 1.0
"""How far behind its place at its strut a newcomer stands."""


def carry_over(old: World, new: World) -> None:
    """Positions, velocities, warm starts, grasps and their softness of the load and of all arms that are in both."""
    here, there = old.data, new.data
    there.time = here.time
    pairs = [(old.load_qpos, new.load_qpos, old.load_dof, new.load_dof)]
    for name in old.arms.keys() & new.arms.keys():
        a, b = old.arms[name], new.arms[name]
        pairs += [(a.base_qpos, b.base_qpos, a.base_dof, b.base_dof), (a.arm_qpos, b.arm_qpos, a.arm_dof, b.arm_dof)]
        there.xfrc_applied[b.hand_body] = here.xfrc_applied[a.hand_body]
        there.eq_active[b.weld] = here.eq_active[a.weld]
        new.model.eq_solref[b.weld] = old.model.eq_solref[a.weld]
        new.model.eq_solimp[b.weld] = old.model.eq_solimp[a.weld]
    for qpos, qpos_there, dof, dof_there in pairs:
        there.qpos[qpos_there] = here.qpos[qpos]
        there.qvel[dof_there] = here.qvel[dof]
        there.qacc_warmstart[dof_there] = here.qacc_warmstart[dof]
    for k in range(1, len(old.struts) + 1):  # a hand may hold its strut beside the middle
        a_site, b_site = _site(old.model, k), _site(new.model, k)
        new.model.site_pos[b_site] = old.model.site_pos[a_site]
        new.model.site_quat[b_site] = old.model.site_quat[a_site]


def stand_outside(world: World, arm: str) -> None:
    """Put a robot with an empty hand, in the starting posture, straight behind its place at its strut."""
    ids = world.arms[arm]
    X_WB = base_at_strut(world, ids.strut).compose(Pose.planar(-OUTSIDE_M, 0.0))
    world.data.eq_active[ids.weld] = 0
    world.data.qpos[ids.base_qpos] = X_WB.p[0], X_WB.p[1], X_WB.yaw
    world.data.qpos[ids.arm_qpos] = world.q_home


def _site(model: Any, strut: int) -> int:
    return int(model.site(f"grasp{strut}").id)
