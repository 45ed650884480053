"""The plant's step with N arms, beside MuJoCo's own step of the same model in the same states."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from agents.controllers.interface import Sensed
from agents.safety import SafeController
from deploy.bench.figures import Part, Samples
from deploy.bench.plan import Plan, arms_text, team_of
from deploy.bench.timing import WARM_PART, spread_us
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scene import BareStep
from sim_server.world import build_world

PLANT, MUJOCO, SENSORS = "plant step", "mj_step", "read all sensors"


class Carrying:
    """A plant whose arms are led by their laws, in this process: it goes through the states of a carry."""

    def __init__(self, arms: int) -> None:
        scenario = team_of(arms).load().scenario
        self.plant = MujocoPlant(build_world(scenario))
        arm = ArmModel(scenario.team.arm)
        self._dt_s = scenario.seconds(1)
        self._laws = {
            name: SafeController("paper", make_controller("paper", arm, {}), arm, scenario.team.handover_s)
            for name in scenario.arms
        }
        self.plant.pull("centre", np.array([2.0 * arms, 0.0, 0.0]))  # N: it moves, slowly
        self._bare = BareStep(self.plant.world.model)

    def tick(self) -> dict[str, float]:
        """One tick; wall time of its parts, us."""
        plant, clock = self.plant, time.perf_counter_ns
        start = clock()
        readings = plant.read()
        read = clock()
        for name, law in self._laws.items():
            felt = readings[name]
            effort = law.step(Sensed(*map(np.array, (felt.q, felt.qd, felt.tau, felt.wrench))), self._dt_s)
            plant.command(name, effort.torque, effort.base_force, effort.stiffness)
        self._bare.take(plant.world.data)
        bare_start = clock()
        self._bare.step()
        bare_end = clock()
        self._bare.take(plant.world.data)  # what ran last has the caches; both come after a copy
        plant_start = clock()
        plant.prepare()
        plant.step()
        plant_end = clock()
        return {
            SENSORS: (read - start) / 1e3,
            MUJOCO: (bare_end - bare_start) / 1e3,
            PLANT: (plant_end - plant_start) / 1e3,
        }


def measure_physics(plan: Plan, tell: Callable[[str], None]) -> Part:
    """Every size of team, a turn each after the other."""
    samples, carries = Samples(), {count: Carrying(count) for count in plan.arms}
    for each in carries.values():
        for _ in range(plan.calls // WARM_PART + 1):
            each.tick()
    for k in range(plan.turns):
        for count, each in carries.items():
            tell(f"turn {k + 1} of {plan.turns}, {arms_text(count)}")
            ticks = [each.tick() for _ in range(plan.calls)]
            column, median = arms_text(count), dict[str, float]()
            for part in (PLANT, MUJOCO, SENSORS):
                median[part], p99 = spread_us([tick[part] for tick in ticks])
                samples.add(f"{part}, p50", column, "us", median[part], "less")
                samples.add(f"{part}, p99", column, "us", p99, "less")
            samples.ratio(f"{PLANT} / {MUJOCO}", column, median[PLANT], median[MUJOCO], "less")
    return Part(
        "physics",
        "One step of the physics",
        samples.figures(),
        ("The plant's step: motor drivers, applied forces, MuJoCo. Beside it mj_step on a copy of the same state.",),
    )
