"""The events of a run, as sentences: for the text log of a viewer and the captions of plots."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

TROUBLE = frozenset({"lost", "missed", "refused", "refused_order", "slowed", "fail_grasp", "kill", "stop", "push"})
"""Kinds of events, and of deeds ordered, that are no part of a run without faults."""
STATES = {"joined": "in", "lost": "lost", "leaving": "leaving", "left": "left"}
"""What an agent is after such an event."""
NOT_SAID = frozenset({"tick", "time_s", "kind", "agent", "event", "pid"})


@dataclass(frozen=True, slots=True)
class Happening:
    """One event."""

    time_s: float
    kind: str
    text: str
    agent: str
    """Whom it is about; empty for nobody."""
    state: str
    """What that agent is from now on; empty if that has not changed."""
    is_trouble: bool


def happening(event: Mapping[str, Any]) -> Happening:
    """A line of events.jsonl, as it was read. Raises :class:`LookupError` or :class:`ValueError` for what is none."""
    kind, agent, what = str(event["kind"]), str(event.get("agent", "")), str(event.get("event", ""))
    details = ", ".join(_detail(key, value) for key, value in event.items() if key not in NOT_SAID)
    head = " ".join(filter(None, (kind.replace("_", " "), what.replace("_", " "), agent)))
    return Happening(
        time_s=float(event["time_s"]),
        kind=kind,
        text=f"{head}: {details}" if details else head,
        agent=agent,
        state="" if event.get("undone") else STATES.get(kind, ""),
        is_trouble=kind in TROUBLE or what in TROUBLE,
    )


def read_happenings(file: Path) -> Iterator[Happening]:
    """All of a run's. Raises :class:`OSError`, :class:`LookupError` or :class:`ValueError`."""
    for line in file.read_text(encoding="utf-8").splitlines():
        yield happening(json.loads(line))


def _detail(key: str, value: object) -> str:
    if key in ("why", "text", "effect"):
        return str(value)
    shown = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f"{key} {shown}"
