"""A whole carry in one process, without a wire: the plant, the leader and the laws of a run, tick by tick.

A quarter of a run's time, and the same numbers to the last bit (tests/test_carry.py holds it to real processes).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from agents.controllers.interface import Sensed
from agents.leader import LeaderSettings, pull
from agents.safety import SafeController
from sim_server.metrics import TraceFacts, physical_metrics
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario import Scenario
from sim_server.trace import columns
from sim_server.world import World, build_world
from wire.arms.limits import arm_limits
from wire.messages import LeaderView

Array = NDArray[np.float64]
Disturb = Callable[[int, MujocoPlant, dict[str, SafeController]], None]
"""``disturb(tick, plant, laws)`` before each tick; a law that is taken out of ``laws`` commands no more."""


@dataclass(frozen=True)
class CarriedOnce:
    """What came of a carry."""

    trace: Mapping[str, Array]
    facts: TraceFacts

    def metrics(self, until_s: float = math.inf) -> Mapping[str, Any]:
        """Of its first part."""
        rows = self.trace["time_s"] < until_s
        return physical_metrics({name: values[rows] for name, values in self.trace.items()}, self.facts)


def carried(
    scenario: Scenario,
    law: str | None = None,
    gains: Mapping[str, Any] | None = None,
    disturb: Disturb = lambda tick, plant, laws: None,
) -> CarriedOnce:
    """Carry once.

    Args:
        law, gains: in place of the scenario's.
        disturb: what is done to plant and laws; the scenario's own events are not.

    Raises:
        PlantFailed: the load is thrown away.
    """
    world, team = build_world(scenario), scenario.team
    plant, arm = MujocoPlant(world), ArmModel(team.arm)
    law, gains = (team.controller, team.gains) if law is None else (law, gains or {})
    laws = {
        each: SafeController("law", make_controller(law, arm, gains), arm, team.handover_s) for each in scenario.arms
    }
    for each_law in laws.values():
        each_law.carry_at(plant.carry_height_m)
    dt_s, rows = scenario.seconds(1), list[Array]()
    for tick in range(scenario.ticks):
        disturb(tick, plant, laws)
        readings = plant.read()
        plant.prepare()
        _lead(tick, scenario, plant)
        for each, each_law in laws.items():
            reading = readings[each]
            effort = each_law.step(Sensed(*map(np.array, (reading.q, reading.qd, reading.tau, reading.wrench))), dt_s)
            plant.command(each, effort.torque, effort.base_force, effort.stiffness)
        before = plant.state_row() if tick % scenario.record.every_ticks == 0 else None
        plant.step()
        if before is not None:
            rows.append(np.concatenate([np.ravel(part) for part in plant.force_row(before)]))
    return CarriedOnce(_named(np.array(rows), scenario.arms, arm_limits(team.arm).joints), _facts(scenario, world))


def _lead(tick: int, scenario: Scenario, plant: MujocoPlant) -> None:
    """What the leader process would do at this tick."""
    leader = scenario.leader
    if leader is None or tick * scenario.clock.control_period_ms % leader.period_ms:
        return
    pose = plant.load_pose()
    view = LeaderView(
        tick,
        round(tick * scenario.seconds(1) * 1e9),
        tuple(pose.position.tolist()),
        tuple(pose.quat_wxyz.tolist()),
        tuple(pose.linear_velocity.tolist()),
        tuple(pose.angular_velocity.tolist()),
    )
    told = LeaderSettings(
        "", leader.goal_m, leader.force_max_N, leader.stiffness_N_m, leader.damping_Ns_m, leader.point
    )
    plant.pull(leader.point, pull(view, np.array(plant.points[leader.point]), told))


def _named(rows: Array, arms: Sequence[str], joints: int) -> Mapping[str, Array]:
    found, start = {}, 0
    for name, width in columns(arms, joints).items():
        found[name] = rows[:, start : start + width] if width > 1 else rows[:, start]
        start += width
    return found


def _facts(scenario: Scenario, world: World) -> TraceFacts:
    return TraceFacts(
        scenario.arms,
        scenario.leader.goal_m if scenario.leader else None,
        world.load_mass,
        (float(world.load_com[0]), float(world.load_com[1]), float(world.load_com[2])),
        {each: world.struts[ids.strut].p.tolist() for each, ids in world.arms.items()},
        arm_limits(scenario.team.arm).torque_Nm,
    )
