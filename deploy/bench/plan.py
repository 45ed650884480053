"""How much is measured: teams, times and turns. And the team of N arms that all parts use."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from deploy.planned_run import merged
from sim_server.scenario_files import NamedScenario, load_scenario

KG_PER_ARM = 5.0
TABLE_PER_ARM_M = 0.45


@dataclass(frozen=True, slots=True)
class Plan:
    """What every part goes by."""

    arms: tuple[int, ...] = (1, 2, 4, 8, 16)
    team: int = 4
    """Arms of those measurements that are made for one size of team only."""
    seconds: float = 4.0
    """Wall time that a carry gets from its first tick on."""
    slice_s: float = 0.5
    """Wall time of one turn of a bare transport."""
    turns: int = 3
    calls: int = 2000
    """Of a function that is timed alone, per turn."""
    rates_hz: tuple[int, ...] = (250, 500, 1000)

    def as_fields(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


QUICK = Plan(arms=(1, 2), team=2, seconds=0.4, slice_s=0.1, turns=1, calls=100, rates_hz=(250,))
"""Everything once and briefly: whether it works, not how fast it is."""


@dataclass(frozen=True, slots=True)
class TeamOf:
    """A carry by so many arms, as a scenario and what is changed of it."""

    scenario: str
    changes: dict[str, Any]

    def load(self, above: dict[str, Any] | None = None) -> NamedScenario:
        """The scenario, with more changes laid over it."""
        return load_scenario(self.scenario, merged(self.changes, above or {}))


def team_of(count: int) -> TeamOf:
    """``transport`` with so many arms: 5 kg for each, and a table that all of them fit around. One arm alone carries
    the small crate of ``transport-one``."""
    if count == 1:
        return TeamOf("transport-one", {})
    size_m = [max(1.6, round(TABLE_PER_ARM_M * count, 3)), 0.9, 0.75]
    load = {"struts": count, "size_m": size_m, "mass_kg": KG_PER_ARM * count}
    return TeamOf("transport", {"team": {"count": count}, "load": load})


def arms_text(count: int) -> str:
    """``1 arm``, ``4 arms``."""
    return f"{count} arm" if count == 1 else f"{count} arms"
