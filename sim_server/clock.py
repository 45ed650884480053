"""Which clock a run has: what the server needs of one, and the choice by the scenario."""

from __future__ import annotations

from typing import Protocol

from sim_server.lockstep import LockStep, Timings
from sim_server.plant import Plant
from sim_server.punctuality import Punctuality
from sim_server.realtime import RealTime
from sim_server.reception import Arrived, Reception, Report
from sim_server.scenario import Scenario


class Clock(Protocol):
    """Drives the agents and the plant's commands; the server steps the plant in between."""

    timings: Timings
    punctuality: Punctuality

    def admit(self) -> None:
        """Let those in whose links are up."""
        ...

    def take(self, arrived: Arrived) -> None:
        """Deal with one thing from the inbox. Raises :class:`sim_server.lockstep.Stopped`."""
        ...

    def tick(self, tick: int) -> None:
        """One tick up to, and without, the plant's step. Raises :class:`sim_server.lockstep.Stopped`."""
        ...


def make_clock(scenario: Scenario, reception: Reception, plant: Plant, report: Report) -> Clock:
    """The clock that the scenario asks for."""
    settings, leader = scenario.clock, scenario.leader
    period_ns = settings.control_period_ms * 1_000_000
    leader_every = leader.period_ms // settings.control_period_ms if leader else 1
    if settings.mode == "real-time":
        return RealTime(reception, plant, period_ns=period_ns, leader_every=leader_every, report=report)
    return LockStep(
        reception,
        plant,
        period_ns=period_ns,
        leader_every=leader_every,
        answer_timeout_s=settings.answer_timeout_s,
        report=report,
    )
