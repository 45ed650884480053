"""Which of a schedule's events were seen to take effect, by what the run's events tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def unseen_faults(schedule: Sequence[Mapping[str, Any]], events: Sequence[Mapping[str, Any]]) -> list[str]:
    """Those of the scheduled events that were not both ordered and seen, in words.

    An event counts as seen by the first sight of its kind and target after it was ordered.
    """
    ordered: dict[tuple[str, str], int] = {}
    seen: dict[tuple[str, str], int] = {}
    for event in events:
        key = str(event.get("event", "")), _target(event)
        if event["kind"] == "ordered":
            ordered[key] = ordered.get(key, 0) + 1
        elif event["kind"] == "seen" and seen.get(key, 0) < ordered.get(key, 0):
            seen[key] = seen.get(key, 0) + 1
    unseen = []
    for event in schedule:
        key = str(event["kind"]), _target(event)
        if seen.get(key, 0) > 0:
            seen[key] -= 1
        else:
            unseen.append(f"{key[0]} of {key[1]} at {event['at_s']:g} s")
    return unseen


def _target(event: Mapping[str, Any]) -> str:
    return str(event.get("agent") or event.get("arm") or event.get("point") or "load")
