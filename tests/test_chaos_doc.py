"""docs/chaos.md and the list of faults are one: every kind has its row, with all its settings and their defaults."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from pydantic.fields import FieldInfo

from sim_server.faults.event import Fault
from sim_server.faults.registry import FAULTS
from sim_server.scenario_events import EVENT_KINDS

PAGE = (Path(__file__).parent.parent / "docs" / "chaos.md").read_text(encoding="utf-8")
COMMON = ("kind", "at_s")
"""Keys of every event."""


def setting(name: str, field: FieldInfo) -> str:
    """A key as its table has it: with its default, if it has one that says something."""
    if field.is_required():
        return f"`{name}`"
    return f"`{name}`" if field.default is None else f"`{name}` ({shown(field.default)})"


def shown(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(f"{each:g}" for each in value) + "]"
    return f"`{value}`" if isinstance(value, str) else f"{value:g}"


def row(fault: Fault) -> str:
    fields = {name: each for name, each in fault.settings.model_fields.items() if name not in COMMON}
    if fields.get("arm") is not None and fields["arm"].annotation is type(None):
        del fields["arm"]
    keys = ", ".join(setting(name, each) for name, each in sorted(fields.items(), key=lambda each: order(each[0])))
    return f"| `{fault.kind}` | {keys} | {fault.does} | {fault.proof} |"


def order(name: str) -> int:
    """Whom it hits comes first, and how long it lasts; the rest is in the order of the settings."""
    first = ("agent", "arm", "direction", "for_s", "probability")
    return first.index(name) if name in first else len(first)


@pytest.mark.parametrize("family", ["process", "message", "physical"])
def test_the_table_of_a_family_is_that_of_its_faults(family: str) -> None:
    heading = {"process": "## Processes", "message": "## Messages", "physical": "## The simulated world"}[family]
    section = PAGE.partition(heading)[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `.*$", section, re.MULTILINE)
    assert rows == [row(fault) for fault in FAULTS if fault.family == family]


def test_every_event_but_a_robot_that_comes_is_a_fault() -> None:
    kinds = sorted(fault.kind for fault in FAULTS)
    assert kinds == sorted(EVENT_KINDS.keys() - {"join"})
    for fault in FAULTS:
        assert EVENT_KINDS[fault.kind] is fault.settings
