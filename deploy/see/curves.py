"""What is plotted of a run, in a viewer or on paper: numbers over time, each with its question and its unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_server.metrics import TraceFacts, goal_distance_m, hand_forces, roll_pitch_yaw_deg, tilt_deg

Array = NDArray[Any]

LOAD, LEADER = "load", "leader"
"""Lines that belong to no arm."""


@dataclass(frozen=True, slots=True)
class Question:
    """What a plot answers."""

    key: str
    """Short name, for options and file names."""
    text: str
    quantity: str
    unit: str


GOAL = Question("goal", "Does the load arrive?", "distance to the goal", "m")
TILT = Question("tilt", "Is it kept level?", "tilt of the load", "deg")
SAG = Question("sag", "Is it kept up?", "height against the start", "mm")
TURN = Question("turn", "Is it turned?", "turn of the load", "deg")
SHARE = Question("share", "Who bears how much?", "upward force of each hand", "N")
INTERNAL = Question("internal", "Do the arms work against each other?", "force that moves nothing", "N")
STIFFNESS = Question("stiffness", "When do the arms stiffen?", "mean joint stiffness", "N m/rad")
TORQUE = Question("torque", "How near are the motors to their limits?", "largest torque of its limit", "%")
PULL = Question("pull", "How hard does the leader pull?", "pull of the leader", "N")
LATENCY = Question("latency", "How old are the commands?", "age of the command obeyed", "ticks")
TICK = Question("tick", "How long does a tick take?", "wall time of a tick", "us")
"""Only while a run goes on: no trace has wall times."""

QUESTIONS = (GOAL, TILT, SAG, TURN, SHARE, INTERNAL, STIFFNESS, TORQUE, PULL, LATENCY)


@dataclass(frozen=True, slots=True)
class Start:
    """How the load stood in the first row of a run: what is measured against it needs it, wherever a block begins."""

    height_m: float
    yaw_deg: float

    @classmethod
    def of(cls, trace: Mapping[str, Array]) -> Start:
        """The start of a trace that begins with the run."""
        yaw = roll_pitch_yaw_deg(trace["load.quat_wxyz"][:1])[0, 2]
        return cls(float(trace["load.position"][0, 2]), float(yaw))


def curves(trace: Mapping[str, Array], facts: TraceFacts, start: Start) -> dict[Question, dict[str, Array]]:
    """Every question's lines by name (an arm, ``load`` or ``leader``), (rows,) each; NaN where there is nothing.

    Args:
        trace: a block of rows, or all.
        facts: of the run. Arms that the block has no columns for have no lines.
        start: of the run.
    """
    arms = tuple(arm for arm in facts.arms if f"{arm}.q" in trace)
    position, quat = trace["load.position"], trace["load.quat_wxyz"]
    turn = roll_pitch_yaw_deg(quat)[:, 2] - start.yaw_deg
    turn -= 360.0 * np.round(turn[0] / 360.0) if turn.size else 0.0
    found: dict[Question, dict[str, Array]] = {
        TILT: {LOAD: tilt_deg(quat)},
        SAG: {LOAD: 1e3 * (position[:, 2] - start.height_m)},
        TURN: {LOAD: turn},
    }
    if facts.goal_m is not None:
        found[GOAL] = {LOAD: goal_distance_m(position, facts.goal_m)}
        found[PULL] = {LEADER: np.linalg.norm(trace["leader.force"], axis=1)}
    if arms:
        found |= _of_arms(trace, facts, arms)
    return {question: found[question] for question in QUESTIONS if question in found}


def _of_arms(trace: Mapping[str, Array], facts: TraceFacts, arms: tuple[str, ...]) -> dict[Question, dict[str, Array]]:
    present = TraceFacts(
        arms, facts.goal_m, facts.load_mass_kg, facts.centre_of_mass_m, facts.grasps_m, facts.torque_max_Nm
    )
    grips, here, internal = hand_forces(trace, present)
    nothing = ~here
    up = np.where(nothing, np.nan, grips[:, :, 2])
    against = np.where(nothing, np.nan, np.linalg.norm(internal[:, :, :3], axis=2))
    limit = np.array(facts.torque_max_Nm)
    return {
        SHARE: {arm: up[:, k] for k, arm in enumerate(arms)},
        INTERNAL: {arm: against[:, k] for k, arm in enumerate(arms)},
        STIFFNESS: {arm: trace[f"{arm}.stiffness"].mean(axis=1) for arm in arms},
        TORQUE: {arm: 100.0 * (np.abs(trace[f"{arm}.tau"]) / limit).max(axis=1) for arm in arms},
        LATENCY: {arm: np.asarray(trace[f"{arm}.age_ticks"], float) for arm in arms},
    }
