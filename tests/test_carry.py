"""The claim itself: the paper's law carries the table to the goal, and adaptive stiffness does it better.

Whole carries run in one process here, on the same plant, law and leader, without a wire: a quarter of the time. That
the real processes do the same is another claim, and tested as such: number for number, over the first part of a carry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from processes import run_to_end

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from agents.controllers.interface import Sensed
from agents.leader import LeaderSettings, pull
from agents.safety import SafeController
from sim_server.metrics import TraceFacts, physical_metrics
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario_files import load_scenario
from sim_server.trace import TraceWriter, read_trace
from sim_server.world import build_world
from wire.arms.limits import arm_limits
from wire.messages import LeaderView

Array = NDArray[Any]


@dataclass
class Carry:
    """What came of a carry."""

    trace: Mapping[str, Array]
    facts: TraceFacts

    def metrics(self, until_s: float = math.inf) -> Mapping[str, Any]:
        """Of its first part."""
        rows = self.trace["time_s"] < until_s
        return physical_metrics({name: values[rows] for name, values in self.trace.items()}, self.facts)


def carry(name: str, tmp_path: Path, changes: dict[str, Any]) -> Carry:
    """A scenario carried in this process, without a wire."""
    scenario = load_scenario(name, changes).scenario
    world = build_world(scenario)
    plant, arm, limits = MujocoPlant(world), ArmModel(scenario.team.arm), arm_limits(scenario.team.arm)
    team = scenario.team
    laws = {
        each: SafeController("law", make_controller(team.controller, arm, team.gains), arm, team.handover_s)
        for each in scenario.arms
    }
    for law in laws.values():
        law.carry_at(plant.carry_height_m)
    leader = scenario.leader
    trace = TraceWriter(tmp_path / f"{name}.parquet", scenario.arms, limits.joints)
    for tick in range(scenario.ticks):
        readings = plant.read()
        plant.prepare()
        if leader is not None and tick % leader.period_ms == 0:
            pose = plant.load_pose()
            view = LeaderView(
                tick,
                tick * 1_000_000,
                tuple(pose.position.tolist()),
                tuple(pose.quat_wxyz.tolist()),
                tuple(pose.linear_velocity.tolist()),
                tuple(pose.angular_velocity.tolist()),
            )
            told = LeaderSettings(
                "", leader.goal_m, leader.force_max_N, leader.stiffness_N_m, leader.damping_Ns_m, leader.point
            )
            plant.pull(leader.point, pull(view, np.array(plant.points[leader.point]), told))
        for each, law in laws.items():
            reading = readings[each]
            effort = law.step(Sensed(*map(np.array, (reading.q, reading.qd, reading.tau, reading.wrench))), 1e-3)
            plant.command(each, effort.torque, effort.base_force, effort.stiffness)
        before = plant.state_row() if tick % scenario.record.every_ticks == 0 else None
        plant.step()
        if before is not None:
            trace.append(plant.force_row(before))
    trace.close()
    facts = TraceFacts(
        scenario.arms,
        leader.goal_m if leader else None,
        world.load_mass,
        (float(world.load_com[0]), float(world.load_com[1]), float(world.load_com[2])),
        {each: world.struts[ids.strut].p.tolist() for each, ids in world.arms.items()},
        limits.torque_Nm,
    )
    return Carry(read_trace(tmp_path / f"{name}.parquet"), facts)


@pytest.fixture(scope="module")
def transport(tmp_path_factory: pytest.TempPathFactory) -> Carry:
    return carry("transport", tmp_path_factory.mktemp("transport"), {})


@pytest.mark.timeout(400)
def test_four_arms_carry_the_table_to_the_goal(transport: Carry) -> None:
    metrics = transport.metrics()
    assert metrics["duration_s"] == pytest.approx(20.0, abs=0.01)
    # The issue's own bounds, not what was measured: they must hold whatever else changes.
    assert metrics["goal_error_m"] <= 0.10
    assert metrics["end_speed_mm_s"] <= 5.0  # standing still: it would take minutes to leave the goal's 0.10 m
    assert metrics["tilt_max_deg"] <= 0.5
    assert metrics["sag_max_mm"] <= 12.0
    assert metrics["leader_force_max_N"] <= 40.0


@pytest.mark.system
@pytest.mark.timeout(200)
def test_four_silent_processes_do_the_same_number_for_number(transport: Carry, tmp_path: Path) -> None:
    """Borders between processes, messages, credentials and walls change no bit of the carry."""
    out = tmp_path / "run"
    done = run_to_end("run", "transport", "--set", "duration_s=1.5", "--out", out, cwd=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr  # the goal is not reached by then
    real = read_trace(out / "trace.parquet")
    rows = len(real["tick"])
    assert rows == 300
    for name, values in real.items():
        if not name.endswith("age_ticks"):
            np.testing.assert_array_equal(values, transport.trace[name][:rows], err_msg=name)


@pytest.mark.timeout(300)
def test_adaptive_stiffness_sags_and_tilts_clearly_less_than_fixed(transport: Carry, tmp_path: Path) -> None:
    span_s = 6.0  # the pull, the fastest part of the carry, and the start of braking
    adaptive = transport.metrics(span_s)
    fixed = carry("transport-fixed-stiffness", tmp_path, {"duration_s": span_s}).metrics()
    # Seen: sag 7.9 and 13.8 mm, rms tilt 0.09 and 0.17 deg. "Clearly" is taken as a fifth less.
    assert adaptive["sag_max_mm"] < 0.8 * fixed["sag_max_mm"]
    assert adaptive["tilt_rms_deg"] < 0.8 * fixed["tilt_rms_deg"]


@pytest.mark.timeout(300)
def test_a_table_that_nobody_leads_is_held_and_hardly_drifts(tmp_path: Path) -> None:
    metrics = carry("hold", tmp_path, {"duration_s": 5.0}).metrics()
    assert metrics["sag_max_mm"] <= 12.0
    assert metrics["tilt_max_deg"] <= 0.5
    # Trap: with alpha = 1 in the law a sagging table runs away by metres. Seen: 3 mm/min; a hundred would be a runaway.
    assert metrics["drift_mm_per_min"] < 30.0
