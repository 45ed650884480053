"""run.json: what ran, on which versions, who took part, how it ended, and what only the running system can measure."""

from __future__ import annotations

import importlib.metadata
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim_server.checkpoint import Checkpoints
from sim_server.lockstep import Ticker, Timings
from sim_server.mujoco_plant import MujocoPlant
from sim_server.reception import Agent, Reception
from sim_server.scenario_files import NamedScenario
from wire.arms.limits import arm_limits


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run ended."""

    completed: bool
    why: str
    wall_s: float
    """Wall time from the first tick to the last."""
    unproven: Sequence[str] = ()
    """A sentence for each event that was not seen to take effect."""


def describe_run(
    run: str,
    named: NamedScenario,
    plant: MujocoPlant,
    reception: Reception,
    clock: Ticker,
    checkpoints: Checkpoints,
    ending: Ending,
) -> dict[str, Any]:
    """The content of run.json."""
    scenario = named.scenario
    return {
        "run": run,
        "scenario_name": named.name,
        "scenario_file": named.source,
        "scenario": scenario.model_dump(mode="json"),
        "seed": scenario.seed,
        "clock": scenario.clock.mode,
        "versions": versions(),
        "started_at": checkpoints.story.started_at.isoformat(timespec="seconds"),
        "resumed": checkpoints.story.resumed,
        "checkpoints": checkpoints.describe(),
        "ended": {"completed": ending.completed, "why": ending.why, "ticks": plant.tick},
        "unproven": list(ending.unproven),
        "agents": describe_agents(reception),
        "strangers_refused": reception.strangers,
        "facts": _facts(plant),
        "measured": _measured(plant.time_s, clock.timings, reception.refused(), ending.wall_s)
        | clock.punctuality.describe(reception.agents)
        | ({"grasp_force_max_N": plant.hands.force_max_N} if plant.hands.force_max_N else {}),
    }


def describe_agents(reception: Reception) -> dict[str, dict[str, Any]]:
    """Every agent's process and life."""
    return {name: _agent(agent) for name, agent in reception.agents.items()}


def _agent(agent: Agent) -> dict[str, Any]:
    return {
        "pid": agent.hello.pid if agent.hello else None,
        "host": agent.hello.host if agent.hello else None,
        "phase": agent.link.phase,
        "lease": agent.link.lease,
        "missed_ticks": agent.link.missed,
        "refused": agent.link.refused,
    }


def _facts(plant: MujocoPlant) -> dict[str, Any]:
    """What the metrics need besides the trace, and how the arms differ from their description."""
    world = plant.world
    scenario = world.scenario
    return {
        "arms": list(plant.met),
        "goal_m": list(scenario.leader.goal_m) if scenario.leader else None,
        "load_mass_kg": world.load_mass,
        "centre_of_mass_m": world.load_com.tolist(),
        "struts": {name: ids.strut for name, ids in plant.met.items()},
        "grasps_m": {name: world.struts[ids.strut].p.tolist() for name, ids in plant.met.items()},
        "torque_max_Nm": list(arm_limits(scenario.team.arm).torque_Nm),
        "differences": {
            name: {
                "link_scale": ids.differences.link_scale.tolist(),
                "joint_damping_Nms_rad": ids.differences.joint_damping.tolist(),
                "joint_friction_Nm": ids.differences.joint_friction.tolist(),
            }
            for name, ids in plant.met.items()
        },
    }


def _measured(simulated_s: float, timings: Timings, refused: int, wall_s: float) -> dict[str, Any]:
    """What only the running system knows: wall times and refusals."""
    parts = {"send": timings.send, "wait": timings.wait, "step": timings.step, "record": timings.record}
    return {
        "real_time_factor": simulated_s / wall_s if wall_s > 0 else 0.0,
        "wall_s": wall_s,
        "tick_us": timings.tick.spread_us(),
        "controller_us": timings.controller.spread_us(),
        "tick_parts_us": {name: times.spread_us() for name, times in parts.items()},
        "refused_messages": refused,
    }


def versions() -> dict[str, str | None]:
    """Versions of what decides the numbers, and the commit when this is a checkout."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("palanquin", "mujoco", "numpy", "eclipse-zenoh", "pyarrow", "pin"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = None  # such as pin, on a machine that only simulates
    return found | {"commit": _commit()}


def _commit() -> str | None:
    """The checkout's commit, with ``+changes`` when files differ from it; None when this is no checkout."""
    here = Path(__file__)

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(here.parent), *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", here.name)  # else this is somebody else's repository around our installation
        commit, changed = git("rev-parse", "HEAD"), git("status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return None
    return commit + ("+changes" if changed else "")
