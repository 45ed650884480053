"""Where the time of a lock-step tick goes: ``python benchmarks/tick_budget.py [SECONDS [ARMS]]``.

Two tables from one call, so that they can be compared: the parts measured alone and warm, in this process; and the
parts as they are in a real run of four followers (or ARMS), where every process wakes up to cold caches, for SECONDS of
wall time. Prints, asserts nothing. What stands beside the whole, and is kept in a file: ``palanquin bench``.
"""

from __future__ import annotations

import os
import sys
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the launcher does for every process of a run

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from agents.arm_model import ArmModel
from agents.controllers.interface import Sensed
from agents.controllers.paper import PaperController
from agents.follower import Follower, FollowerSettings
from deploy.bench.carry import carry
from deploy.bench.plan import TeamOf, team_of
from deploy.bench.timing import Action, spread_us, times_us
from sim_server.mujoco_plant import MujocoPlant
from sim_server.world import build_world
from wire.codec import decode, encode
from wire.messages import Command, State

REPEATS = 1000


def median_us(action: Action) -> float:
    """Median wall time of an action, us."""
    return spread_us(times_us({"": action}, REPEATS)[""])[0]


def warm_parts(team: TeamOf) -> dict[str, float]:
    """Each part alone, us."""
    scenario = team.load().scenario
    world = build_world(scenario)
    plant = MujocoPlant(world)
    follower = Follower(FollowerSettings("bench", "a1", scenario.team.arm, "paper", {}))
    arm = ArmModel(scenario.team.arm)
    q, qd = world.q_home.copy(), np.zeros(arm.joints)
    controller, sensed = PaperController(arm), Sensed(q, qd, np.zeros(arm.joints), np.zeros(6))
    reading = plant.read()["a1"]
    state = State("a1", 0, 0, reading.q, reading.qd, reading.tau, reading.wrench, reading.grip_m, reading.odometry)
    command = follower.answer(state, 1, 1e-3)
    state_bytes, command_bytes = encode(state), encode(command)
    row = plant.state_row()
    return {
        "follower: whole answer (decode, law, encode)": median_us(
            lambda: encode(follower.answer(decode(state_bytes, State), 1, 1e-3))
        ),
        "follower: of that, the law and the arm's terms": median_us(lambda: controller.step(sensed, 1e-3)),
        "beside it: Pinocchio's terms alone": median_us(lambda: arm.snapshot(q, qd)),
        "follower: of that, decode a state": median_us(lambda: decode(state_bytes, State)),
        "simulator: read all sensors": median_us(plant.read),
        "simulator: encode one state": median_us(lambda: encode(state)),
        "simulator: decode one command": median_us(lambda: decode(command_bytes, Command)),
        "simulator: one plant step": median_us(plant.step),
        "simulator: of that, mj_step": median_us(lambda: mujoco.mj_step(world.model, world.data)),
        "simulator: one row of the trace": median_us(lambda: (plant.state_row(), plant.force_row(row))),
    }


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    arms = int(sys.argv[2]) if len(sys.argv) > 2 else 4
    team = team_of(arms)
    console = Console()
    warm = Table("alone and warm", "median us", title=f"{arms} arms, mujoco {mujoco.__version__}")
    for name, value in warm_parts(team).items():
        warm.add_row(name, f"{value:.1f}")
    console.print(warm)
    measured: Any = carry(team, seconds).measured
    real = Table("in a real run", "p50 us", "p99 us")
    rows = {"tick": measured["tick_us"], **{f"  {part}": v for part, v in measured["tick_parts_us"].items()}}
    for name, spread in (rows | {"controller step, in the followers": measured["controller_us"]}).items():
        real.add_row(name, f"{spread['p50']:.0f}", f"{spread['p99']:.0f}")
    console.print(real)
    console.print(f"real_time_factor {measured['real_time_factor']:.2f}")


if __name__ == "__main__":
    main()
