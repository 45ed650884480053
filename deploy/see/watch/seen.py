"""What an observer knows of a run: a value that rows, events and reports of progress are folded into. No clock here."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from deploy.see.happenings import Happening, happening
from deploy.see.watch.rows import Arm, Load, is_readable, read_row, read_ways
from wire.messages import Event, Progress, Row

LEADER = "leader"
MOST_HAPPENINGS, MOST_TILTS, MOST_PLACES = 100, 240, 400
PLACE_M = 0.02
"""Way of the load between two places that are kept of its path."""
JUDGED = "judged"
"""Kind of the event that says the verdict."""


@dataclass(frozen=True, slots=True)
class Seen:
    """All that a dashboard shows.

    States of agents are ``awaited``, ``in``, ``leaving``, ``left`` and ``lost``, or ``there`` for an arm that was there
    before the observer came and of whom nothing has been told since.
    """

    run: str
    progress: Progress | None = None
    """The newest."""
    load: Load | None = None
    start: Load | None = None
    """The load when it was seen for the first time."""
    arms: Mapping[str, Arm] = field(default_factory=dict)
    """Those in the newest row."""
    states: Mapping[str, str] = field(default_factory=dict)
    """Agents in the order in which they were heard of."""
    happenings: tuple[Happening, ...] = ()
    """The last ones, the newest at the end."""
    happened: int = 0
    """How many there have been."""
    tilts_deg: tuple[float, ...] = ()
    """The largest tilt of each of the last looks."""
    tilt_max_deg: float = math.nan
    path_m: tuple[tuple[float, float], ...] = ()
    """Where the load has been, (x, y) in the world."""
    tick: int = 0
    time_s: float = 0.0
    ended: str | None = None
    """Why the run has ended; None while it goes on."""
    verdict: str = ""
    refused: int = 0
    """Messages that did not fit."""

    @property
    def phase(self) -> str:
        """``unheard``, ``waiting``, ``running`` or ``ended``."""
        if self.ended is not None:
            return "ended"
        return "unheard" if self.progress is None else self.progress.phase

    @property
    def arm_names(self) -> list[str]:
        """Every arm that was ever heard of: a2 before a10."""
        known = {*self.arms, *self.states} - {LEADER}
        return sorted(known, key=lambda name: (len(name), name))

    def state_of(self, agent: str) -> str:
        """The state of an agent; empty for nobody known."""
        return self.states.get(agent, "there" if agent in self.arms else "")


def look(
    seen: Seen,
    rows: Sequence[Row] = (),
    events: Iterable[Event] = (),
    progress: Iterable[Progress] = (),
    refused: int = 0,
) -> Seen:
    """What is known after one more look.

    Args:
        seen: what was known before.
        rows, events, progress: what has come since, oldest first.
        refused: messages that have come since and were no messages.
    """
    seen = _with_rows(replace(seen, refused=seen.refused + refused), rows)
    for each in progress:
        seen = _with_progress(seen, each)
    for event in events:
        seen = _with_event(seen, event)
    return seen


def _with_rows(seen: Seen, rows: Sequence[Row]) -> Seen:
    readable = [row for row in rows if is_readable(row)]
    seen = replace(seen, refused=seen.refused + len(rows) - len(readable))
    if not readable:
        return seen
    p_WO, tilts_deg = read_ways(readable)
    known = tilts_deg[np.isfinite(tilts_deg)]
    most = float(known.max()) if known.size else math.nan
    load, arms = read_row(readable[-1])
    return replace(
        seen,
        load=load,
        start=seen.start or read_row(readable[0])[0],
        arms=arms,
        tilts_deg=(*seen.tilts_deg, most)[-MOST_TILTS:],
        tilt_max_deg=max((x for x in (seen.tilt_max_deg, most) if math.isfinite(x)), default=math.nan),
        path_m=_path(seen.path_m, p_WO[:, :2].tolist()),
    )


def _path(path: tuple[tuple[float, float], ...], way: Iterable[Sequence[float]]) -> tuple[tuple[float, float], ...]:
    places = list(path)
    for x, y in way:
        if math.isfinite(x + y) and (not places or math.dist((x, y), places[-1]) >= PLACE_M):
            places.append((x, y))
    while len(places) > MOST_PLACES:  # a long way is kept whole, more and more coarsely
        places = [*places[:-1:2], places[-1]]
    return tuple(places)


def _with_progress(seen: Seen, progress: Progress) -> Seen:
    awaited = progress.waiting_for.split(", ") if progress.waiting_for else []
    # Not those who are in: what they said has come on another key, and may be newer.
    states = dict(seen.states) | {name: "awaited" for name in awaited if seen.state_of(name) != "in"}
    return replace(seen, progress=progress, states=states, tick=progress.tick, time_s=progress.time_s)


def _with_event(seen: Seen, event: Event) -> Seen:
    try:
        details = json.loads(event.details)
        what = happening({**details, "tick": event.tick, "time_s": event.time_s, "kind": event.kind})
    except (LookupError, TypeError, ValueError):
        return replace(seen, refused=seen.refused + 1)
    seen = replace(seen, happenings=(*seen.happenings, what)[-MOST_HAPPENINGS:], happened=seen.happened + 1)
    if what.agent and what.state:
        seen = replace(seen, states={**seen.states, what.agent: what.state})
    if event.kind == "resumed":  # whoever was in greets again
        again = {name: "awaited" if state in ("in", "leaving") else state for name, state in seen.states.items()}
        seen = replace(seen, states=again, tick=event.tick, time_s=event.time_s)
    elif event.kind == "ended":
        seen = replace(seen, ended=str(details.get("why", "")), tick=event.tick, time_s=event.time_s)
    elif event.kind == JUDGED:
        seen = replace(seen, verdict=str(details.get("verdict", "")))
    return seen
