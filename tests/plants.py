"""Small MuJoCo plants for tests: a table of 20 kg and its team."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario import Scenario
from sim_server.world import build_world

QUIET = {
    "position_noise_rad": 0,
    "velocity_noise_rad_s": 0,
    "torque_noise_Nm": 0,
    "wrench_noise_N": 0,
    "wrench_noise_Nm": 0,
}
NO_STIFFNESS = np.zeros(7)


def scenario(count: int = 4, *, step_ms: int = 1, seed: int = 1, **sections: Any) -> Scenario:
    """A table of 20 kg and its team. ``plant`` and ``base`` are laid over the defaults."""
    plant = {"physics_step_ms": step_ms} | sections.pop("plant", {})
    return Scenario.model_validate(
        {
            "description": "test",
            "seed": seed,
            "team": {"count": count},
            "load": {"mass_kg": 20.0} | sections.pop("load", {}),
            "leader": {"goal_m": [2.0, 0.0], "period_ms": 20},
            "clock": {"control_period_ms": step_ms},
            "plant": plant,
            **sections,
        }
    )


def plant_of(given: Scenario) -> MujocoPlant:
    return MujocoPlant(build_world(given))
