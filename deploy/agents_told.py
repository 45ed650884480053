"""Who may take part in a launched run, and what each of its agents is told at its start."""

from __future__ import annotations

from deploy.settings import toml_value
from sim_server.faults.processes import ToProcess
from sim_server.scenario import Scenario, arm_number
from wire.access import Role
from wire.credentials import Guests, for_one_run

SPARE_NAMES = 16
"""Robots that may come in a run without being foreseen."""


def everybody(scenario: Scenario) -> list[str]:
    """Names of all arms that may take part: the team, those who come by its events, and some that nobody foresaw."""
    known = [*scenario.arms, *scenario.joining]
    last = max(arm_number(name) + 1 for name in known)
    return [*known, *(f"a{last + k}" for k in range(1, SPARE_NAMES + 1))]


def guests_of(scenario: Scenario) -> Guests:
    """New credentials for everybody, the leader, and those who watch and give orders."""
    return for_one_run([*everybody(scenario), Role.LEADER, Role.OPERATOR, Role.OBSERVER])


def cut_off(scenario: Scenario) -> set[str]:
    """Agents whose link the scenario cuts."""
    return {event.agent for event in scenario.events if isinstance(event, ToProcess) and event.kind == "disconnect"}


def follower_arguments(scenario: Scenario) -> list[str]:
    """What a follower is told: its arm's model and its law. Nothing of the load, the goal, or how many there are."""
    team = scenario.team
    arguments = ["--arm-model", team.arm, "--controller", team.controller, "--handover-s", repr(team.handover_s)]
    arguments += ["--leave-s", repr(team.leave_s)]
    for key, value in team.gains.items():
        arguments += ["--set", f"{key}={toml_value(value)}"]
    return arguments


def leader_arguments(scenario: Scenario) -> list[str]:
    """What the leader is told."""
    leader = scenario.leader
    if leader is None:
        return []
    return [
        "--goal-m",
        *(repr(x) for x in leader.goal_m),
        *(f"--stop={','.join(map(repr, (*stop.goal_m, stop.until_s)))}" for stop in leader.stops),
        *(f"--waypoint={','.join(map(repr, place))}" for place in leader.waypoints),
        *(["--near-m", repr(leader.near_m)] if leader.waypoints else []),
        *(["--wishes"] if leader.by != "law" else []),
        "--force-max-N",
        repr(leader.force_max_N),
        "--stiffness-N-m",
        repr(leader.stiffness_N_m),
        "--damping-Ns-m",
        repr(leader.damping_Ns_m),
        "--point",
        leader.point,
    ]
