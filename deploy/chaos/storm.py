"""Storms: schedules of faults drawn from a seed, each a scenario that anybody can run again."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from deploy.chaos.catalogue import Event, Fault, Span, faults
from deploy.planned_run import Changes, Run, merged
from deploy.settings import toml_value
from sim_server.errors import ScenarioError, SimError
from sim_server.scenario import Scenario
from sim_server.scenario_files import SHIPPED, load_scenario

STREAM = 0x5702
"""Keeps these draws apart from those of the plant."""
TRIES = 200
"""Draws of one fault before a storm is called full."""


class StormError(SimError):
    """No such storm can be drawn."""


@dataclass(frozen=True)
class Carry:
    """What is carried while the faults strike."""

    scenario: str
    changes: Changes
    window_s: Span
    """When faults strike: while the load moves, with time left to recover."""

    @property
    def resolved(self) -> Scenario:
        """The whole scenario, checked."""
        return load_scenario(self.scenario, self.changes).scenario

    def run(self, group: str, condition: str, law: str, events: Sequence[Event], seed: int) -> Run:
        """It, with these events."""
        changes = merged(self.changes, {"events": list(events)})
        return Run(group, condition, law, self.scenario, changes, seed, may_lose=True)


SHORT: Changes = {"duration_s": 12.0, "leader": {"goal_m": [1.0, 0.0]}}
"""One metre: an undisturbed team arrives after 6 to 8 s and stands still at the end."""
SHORT_WINDOW_S = Span(1.0, 4.0)
"""After the hand-over of the torque (1 s), before the leader slows down; an arm that leaves takes 7.2 s."""


def short_carry(arms: int, preset: str) -> Carry:
    """A short carry by so many arms: the table of `transport`, from five on that of `transport-six`.

    Args:
        preset: the law, as a scenario names it.
    """
    scenario = "transport" if arms <= 4 else "transport-six"
    struts = {4: {}, 6: {}}.get(arms, {"load": {"struts": max(arms, 4)}})
    changes = merged(SHORT, {"team": {"count": arms, "controller": preset}, **struts})
    return Carry(scenario, changes, SHORT_WINDOW_S)


def carry_of(scenario: str | None, arms: int | None, preset: str | None) -> Carry:
    """A scenario of the user's with what is asked to be different, or without one a short carry.

    Raises:
        ScenarioError: there is no such scenario, or it cannot be had so.
    """
    if scenario is None:
        return short_carry(arms or 4, preset or "paper")
    team: dict[str, Any] = {} if preset is None else {"controller": preset}
    changes: dict[str, Any] = {"team": team | ({} if arms is None else {"count": arms})}
    if arms is not None:
        changes["load"] = {"struts": max(arms, load_scenario(scenario).scenario.load.struts)}
    duration_s = load_scenario(scenario, changes).scenario.duration_s
    return Carry(scenario, changes, Span(round(0.1 * duration_s, 3), round(0.4 * duration_s, 3)))


def carry_in(scenario: str) -> Carry:
    """What a scenario file carries, as a change of what it extends: a file made of it then needs that file no more.

    Raises:
        ScenarioError: there is no such scenario.
    """
    load_scenario(scenario)
    file = Path(scenario)
    tables = tomllib.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    if "extends" not in tables:
        return carry_of(scenario, None, None)
    parent = str(tables["extends"])
    beside = (file.parent / f"{parent}.toml").absolute()
    changes = {key: value for key, value in tables.items() if key not in ("extends", "description", "seed", "events")}
    return Carry(str(beside) if beside.is_file() else parent, changes, SHORT_WINDOW_S)


def draw_storm(carry: Carry, seed: int, count: int, rows: Sequence[Fault] | None = None) -> list[Event]:
    """So many faults, in order of time; those that the scenario has already stay.

    What ends an agent's part is drawn once for it, and no other fault with it but pushes, so that every fault can take
    effect. A fault that the scenario's own rules refuse is drawn again.

    Raises:
        StormError: there is no room for so many.
    """
    draws = np.random.default_rng([seed, STREAM])
    rows = [row for row in faults() if not row.alone] if rows is None else rows
    scenario = carry.resolved
    events: list[Event] = [event.model_dump(mode="json", exclude_none=True) for event in scenario.events]
    struck: dict[str, list[Fault]] = {}
    usable = [row for row in rows if row.target != "leader" or scenario.leader is not None]
    for number in range(count):
        for _ in range(TRIES if usable else 0):
            row = usable[int(draws.integers(len(usable)))]
            drawn = row.draw(draws, scenario.arms, carry.window_s)
            target = str(drawn[0].get("agent") or drawn[0].get("arm") or "")
            if _goes_with(row, struck.get(target, ())) and is_valid(carry, [*events, *drawn]):
                events += drawn
                if target:
                    struck.setdefault(target, []).append(row)
                break
        else:
            raise StormError(
                f"--faults {count}: there is room for {number} in this storm: expected fewer, or more arms"
            )
    return in_time(events)


def _goes_with(row: Fault, before: Sequence[Fault]) -> bool:
    """Whether a fault can strike what these have struck or will."""
    if row.kind == "push":
        return True
    others = [fault for fault in before if fault.kind != "push"]
    return not others or not (row.ends or any(other.ends or other.kind == row.kind for other in others))


def is_valid(carry: Carry, events: Sequence[Event]) -> bool:
    """Whether a scenario with these events is one."""
    try:
        replace(carry, changes=merged(carry.changes, {"events": list(events)})).resolved  # noqa: B018
    except ScenarioError:
        return False
    return True


def in_time(events: Sequence[Event]) -> list[Event]:
    """Events by their time; those of one time as they stand."""
    return sorted(events, key=lambda event: float(event["at_s"]))


def scenario_text(carry: Carry, events: Sequence[Event], seed: int, description: str) -> str:
    """The scenario file of a carry with these events.

    What it extends is named if it ships with the package, and told with its whole path if it is the user's file.
    """
    shipped = (SHIPPED / f"{carry.scenario}.toml").is_file()
    extends = carry.scenario if shipped else str(Path(carry.scenario).absolute())
    top = {"extends": extends, "description": description, "seed": seed}
    tables = {key: value for key, value in carry.changes.items() if key != "events"}
    top |= {key: value for key, value in tables.items() if not isinstance(value, Mapping) and key not in top}
    parts = [_lines(top)]
    parts += [f"[{key}]\n{_lines(table)}" for key, table in tables.items() if isinstance(table, Mapping) and table]
    parts += [f"[[events]]\n{_lines(event)}" for event in events]
    return "\n".join(parts)


def _lines(table: Mapping[str, Any]) -> str:
    return "".join(f"{key} = {toml_value(value)}\n" for key, value in table.items())
