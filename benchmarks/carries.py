"""Carries in one process, without a wire: ``python benchmarks/carries.py LAWS [CONDITIONS [SEEDS [KEY=VALUE ...]]]``.

LAWS and CONDITIONS are names with commas between them, SEEDS as well; ``all`` is every condition. The rest are gains.
The same plant, leader and laws as in a run, on the same numbers, some five times as fast as real time: for comparing
laws over many conditions. What disturbs is done to the plant directly. Prints, asserts nothing.

    python benchmarks/carries.py paper,palanquin transport,lost 1,2,3
    python benchmarks/carries.py palanquin all 1 observer_rate_1_s=0.0
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the launcher does for every process of a run

import numpy as np
from numpy.typing import NDArray
from one_process import carried
from rich.console import Console
from rich.table import Table

from agents.safety import SafeController
from sim_server.errors import PlantFailed
from sim_server.faults.pushes import Push
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario import Scenario
from sim_server.scenario_files import load_scenario

Array = NDArray[np.float64]
RECORD_TICKS = 10

HARD_LEADER = {"stiffness_N_m": 40.0, "damping_Ns_m": 120.0}
"""The leader that lets a load swing: see docs/results.md."""


@dataclass(frozen=True)
class Condition:
    """One thing that a law has to stand."""

    changes: Mapping[str, Any] = field(default_factory=dict)
    """Of the scenario ``transport``."""
    differences: float = 1.0
    """Factor on the plant's differences and noises."""
    push: Mapping[str, Any] | None = None
    """An event of a scenario file."""
    lost_s: float | None = None
    """When arm a2 goes limp."""
    slips_s: float | None = None
    """When a2's hand, which holds badly from the start, slips off."""
    scenario: str = "transport"


def team(count: int, mass_kg: float, duration_s: float, leader: Mapping[str, float]) -> Condition:
    """A team of that size, with a table that it fits around."""
    return Condition(
        {
            "team": {"count": count},
            "load": {"struts": count, "size_m": [max(1.6, 0.45 * count), 0.9, 0.75], "mass_kg": mass_kg},
            "leader": dict(leader),
            "duration_s": duration_s,
        }
    )


FOR_2_S = {"kind": "push", "at_s": 3.0, "for_s": 2.0}
ACROSS = {**FOR_2_S, "arm": "a2", "force_N": [0.0, 50.0, 0.0]}
ALONG = {**FOR_2_S, "arm": "a2", "force_N": [50.0, 0.0, 0.0]}
TURN = {**FOR_2_S, "point": "centre_of_mass", "torque_Nm": [0.0, 0.0, 30.0]}
SHORT = {"duration_s": 12.0}

CONDITIONS: Mapping[str, Condition] = {
    "transport": Condition(),
    "transport-x3": Condition(SHORT, 3.0),
    "across-x3": Condition(SHORT, 3.0, ACROSS),
    "along-x3": Condition(SHORT, 3.0, ALONG),
    "turn-x3": Condition(SHORT, 3.0, TURN),
    "failed-x3": Condition(SHORT, 3.0, slips_s=1.0),
    "lost-x3": Condition({"duration_s": 12.0}, 3.0, lost_s=1.0),
    "lost": Condition({"duration_s": 20.0}, lost_s=1.0),
    "dropout": Condition({"duration_s": 20.0}, lost_s=5.0),
    "delay-20": Condition({"duration_s": 12.0, "plant": {"delay_ticks": 20}}),
    "hold": Condition({"duration_s": 8.0}, scenario="hold"),
    "one": Condition({"duration_s": 20.0}, scenario="transport-one"),
    "four": team(4, 20.0, 25.0, {}),
    "eight": team(8, 60.0, 35.0, {}),
    "sixteen": team(16, 120.0, 50.0, {}),
    "four-hard": team(4, 20.0, 30.0, HARD_LEADER),
    "eight-hard": team(8, 60.0, 40.0, HARD_LEADER),
    "sixteen-hard": team(16, 120.0, 50.0, HARD_LEADER),
    "long-offset": Condition(
        {"load": {"size_m": [2.4, 1.0, 0.75], "centre_of_mass_offset_m": [0.3, 0.1, 0.0]}, "duration_s": 15.0}, 3.0
    ),
    "heavy": Condition({"load": {"mass_kg": 30.0}, "duration_s": 12.0}, 3.0),
    "crate": Condition({"load": {"shape": "crate", "size_m": [1.2, 1.2, 0.5]}, "duration_s": 12.0}, 3.0),
    "two": Condition({"team": {"count": 2}, "load": {"mass_kg": 8.0}, "duration_s": 15.0}, 3.0),
    "six": Condition({"duration_s": 25.0}, scenario="transport-six"),
    "period-4ms": Condition({"duration_s": 10.0, "clock": {"control_period_ms": 4}, "leader": {"period_ms": 12}}),
}


@dataclass
class Carried:
    """What came of it."""

    metrics: Mapping[str, Any]
    trace: Mapping[str, Array]
    wall_s: float


def scenario_of(condition: Condition, seed: int) -> Scenario:
    """The condition's scenario."""
    changes = json.loads(json.dumps(condition.changes)) | {"seed": seed}
    changes["record"] = {"every_ticks": RECORD_TICKS}
    changes["plant"] = changes.get("plant", {}) | {"difference_scale": condition.differences}
    if condition.push is not None:
        changes["events"] = [dict(condition.push)]
    return load_scenario(condition.scenario, changes).scenario


def carry(law: str, condition: Condition, seed: int = 1, gains: Mapping[str, Any] | None = None) -> Carried:
    """Carry once. Raises :class:`sim_server.errors.PlantFailed` if the load is thrown away."""
    began = time.perf_counter()
    scenario = scenario_of(condition, seed)

    def disturb(tick: int, plant: MujocoPlant, laws: dict[str, SafeController]) -> None:
        if condition.slips_s is not None and tick == 0:
            plant.loosen("a2", 20.0)
        if condition.lost_s is not None and tick == round(condition.lost_s / scenario.seconds(1)):
            plant.lose("a2")
            del laws["a2"]
        if condition.slips_s is not None and tick == round(condition.slips_s / scenario.seconds(1)):
            plant.slip("a2")
            del laws["a2"]
        for event in scenario.events:
            if isinstance(event, Push) and tick == round(event.at_s / scenario.seconds(1)):
                plant.push(event)

    done = carried(scenario, law, gains or {}, disturb)
    return Carried(done.metrics(), done.trace, time.perf_counter() - began)


SHOWN = {
    "tilt": "tilt_max_deg",
    "tilt rms": "tilt_rms_deg",
    "sag": "sag_max_mm",
    "yaw": "yaw_max_deg",
    "over": "overshoot_m",
    "arrival": "arrival_time_s",
    "error": "goal_error_m",
    "end mm/s": "end_speed_mm_s",
    "internal": "internal_force_rms_N",
    "limit": "torque_limit_fraction",
    "torque": "torque_rms_Nm",
}


def main() -> None:
    laws, names, seeds = (sys.argv[1:] + ["all", "1"][len(sys.argv) - 2 :])[:3]
    gains: dict[str, Any] = {}
    for word in sys.argv[4:]:
        key, _, value = word.partition("=")
        gains[key] = json.loads(value)
    plain = not sys.stdout.isatty()
    table = Table("law", "condition", "seed", *SHOWN, "wall s")
    head = f"{'law':10} {'condition':13} s " + " ".join(f"{each:>8}" for each in SHOWN) + "   wall"
    if plain:
        print(head, flush=True)
    for name in CONDITIONS if names == "all" else names.split(","):
        for law in laws.split(","):
            for seed in map(int, seeds.split(",")):
                try:
                    done = carry(law, CONDITIONS[name], seed, gains)
                    shown = [done.metrics[key] for key in SHOWN.values()]
                    wall = done.wall_s
                except PlantFailed as failed:
                    shown, wall = [None] * len(SHOWN), 0.0
                    print(failed, flush=True)
                values = ["-" if value is None else f"{value:.3f}" for value in shown]
                if plain:
                    print(
                        f"{law:10} {name:13} {seed} " + " ".join(f"{v:>8}" for v in [*values, f"{wall:.0f}"]),
                        flush=True,
                    )
                table.add_row(law, name, str(seed), *values, f"{wall:.0f}")
    if not plain:
        Console().print(table)


if __name__ == "__main__":
    main()
