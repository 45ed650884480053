"""Which clock a run has, by its scenario."""

from __future__ import annotations

from sim_server.faults.edge import Edge
from sim_server.lockstep import LockStep, Ticker
from sim_server.plant import Plant
from sim_server.realtime import RealTime
from sim_server.reception import Reception, Report
from sim_server.scenario import Scenario


def make_clock(scenario: Scenario, reception: Reception, plant: Plant, report: Report) -> Ticker:
    """The clock that the scenario asks for."""
    settings, leader = scenario.clock, scenario.leader
    period_ns = settings.control_period_ms * 1_000_000
    leader_every = leader.period_ms // settings.control_period_ms if leader else 1
    edge = Edge(scenario.seed)
    if settings.mode == "real-time":
        return RealTime(reception, plant, period_ns=period_ns, leader_every=leader_every, report=report, edge=edge)
    return LockStep(
        reception,
        plant,
        period_ns=period_ns,
        leader_every=leader_every,
        answer_timeout_s=settings.answer_timeout_s,
        report=report,
        edge=edge,
    )
