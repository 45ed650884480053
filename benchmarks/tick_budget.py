"""Where the time of a lock-step tick goes: ``python benchmarks/tick_budget.py [SECONDS [ARMS]]``.

Two tables from one call, so that they can be compared: the parts measured alone and warm, in this process; and the
parts as they are in a real run of four followers (or ARMS), where every process wakes up to cold caches. Prints,
asserts nothing.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
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
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario_files import load_scenario
from sim_server.world import build_world
from wire.codec import decode, encode
from wire.messages import Command, State

REPEATS = 1000


def median_us(action: Callable[[], Any]) -> float:
    """Median wall time of an action, us, over many repeats after a tenth of them."""
    times = []
    for k in range(REPEATS + REPEATS // 10):
        start = time.perf_counter_ns()
        action()
        if k >= REPEATS // 10:
            times.append(time.perf_counter_ns() - start)
    return float(np.median(times)) / 1e3


def warm_parts(changes: dict[str, Any]) -> dict[str, float]:
    """Each part alone, us."""
    scenario = load_scenario("transport", changes).scenario
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


def real_run(settings: list[str]) -> dict[str, Any]:
    """What a real run measured of itself."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        palanquin = Path(sys.executable).with_name("palanquin")
        subprocess.run([palanquin, "run", "transport", *settings, "--out", out], stdout=subprocess.DEVNULL, check=False)
        measured: dict[str, Any] = json.loads((out / "run.json").read_text())["measured"]
    return measured


def main() -> None:
    seconds = sys.argv[1] if len(sys.argv) > 1 else "5"
    arms = sys.argv[2] if len(sys.argv) > 2 else "4"
    length = max(1.6, 0.45 * int(arms))
    changes: dict[str, Any] = {
        "team": {"count": int(arms)},
        "load": {"struts": int(arms), "size_m": [length, 0.9, 0.75]},
    }
    settings = ["--set", f"duration_s={float(seconds)}", "--set", f"team.count={arms}", "--set", f"load.struts={arms}"]
    settings += ["--set", f"load.size_m=[{length}, 0.9, 0.75]"]
    console = Console()
    warm = Table("alone and warm", "median us", title=f"{arms} arms, mujoco {mujoco.__version__}")
    for name, value in warm_parts(changes).items():
        warm.add_row(name, f"{value:.1f}")
    console.print(warm)
    measured = real_run(settings)
    real = Table("in a real run", "p50 us", "p99 us")
    rows = {"tick": measured["tick_us"], **{f"  {part}": v for part, v in measured["tick_parts_us"].items()}}
    for name, spread in (rows | {"controller step, in the followers": measured["controller_us"]}).items():
        real.add_row(name, f"{spread['p50']:.0f}", f"{spread['p99']:.0f}")
    console.print(real)
    console.print(f"real_time_factor {measured['real_time_factor']:.2f}")


if __name__ == "__main__":
    main()
