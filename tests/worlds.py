"""Small worlds for tests: a team at the load of its size, and springs that hold it where it is."""

from __future__ import annotations

from typing import Any

import mujoco

from sim_server.scenario import Scenario
from sim_server.world import World

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
