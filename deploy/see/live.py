"""A run that goes on, as rows and events come in: the same recording as :mod:`deploy.see.replay` makes afterwards.

No clock and no socket here.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

import numpy as np

from deploy.see.curves import TICK, Array, Start, curves
from deploy.see.happenings import happening
from deploy.see.recording import Recording
from deploy.see.replay import CURVES_HZ, SCENE_HZ
from sim_server.errors import SimError
from sim_server.looks import shapes
from sim_server.metrics import TraceFacts
from sim_server.playback import Playback, row_s, thinned
from sim_server.scenario import Scenario
from sim_server.trace import columns
from wire.arms.limits import arm_limits
from wire.messages import Event, Row

TICK_NS = "tick_ns"


class Unfitting(SimError):
    """Rows that are not of the scenario that the recorder was told."""


class LiveRun:
    """Turns rows into a recording.

    Args:
        scenario: what the simulator runs.
        recording: where it goes.
    """

    def __init__(self, scenario: Scenario, recording: Recording) -> None:
        self._scenario, self._recording = scenario, recording
        self._limits = arm_limits(scenario.team.arm)
        self._start: Start | None = None
        self._struts = {arm: strut for strut, arm in enumerate(scenario.arms)}
        self._build()

    def _build(self) -> None:
        """The world with all robots so far."""
        self._playback = Playback(self._scenario, self._struts)
        world, scenario = self._playback.world, self._scenario
        goal = scenario.leader.goal_m if scenario.leader else None
        self.facts = TraceFacts(
            arms=tuple(self._struts),
            goal_m=goal,
            load_mass_kg=world.load_mass,
            centre_of_mass_m=tuple(world.load_com.tolist()),
            grasps_m={arm: world.struts[strut].p.tolist() for arm, strut in self._struts.items()},
            torque_max_Nm=tuple(self._limits.torque_Nm),
        )
        """Of all robots so far."""
        first = self._start is None
        self._recording.scene(shapes(world.model), self.facts.arms, goal, scenario.load.size_m, layout=first, live=True)

    def rows(self, rows: Sequence[Row]) -> None:
        """Record rows that came one after the other.

        Raises:
            Unfitting: they are of another scenario.
        """
        for (arms, struts), group in groupby(rows, key=lambda row: (row.arms, row.struts)):
            self._block(arms.split(), struts.split(), list(group))

    def _block(self, arms: Sequence[str], struts: Sequence[str], rows: Sequence[Row]) -> None:
        trace = self._trace(arms, rows)
        seats = dict(zip(arms, (int(strut) - 1 for strut in struts), strict=True))
        if not seats.items() <= self._struts.items():
            self._struts |= seats
            self._build()
        self._start = self._start or Start.of(trace)
        step_s, time_s = row_s(self._scenario), trace["time_s"]
        playback, recording = self._playback, self._recording
        recording.motion(playback.bodies, playback.motion(trace, thinned(time_s, step_s, SCENE_HZ)))
        kept = np.array(thinned(time_s, step_s, CURVES_HZ), dtype=int)
        lines = curves(trace, self.facts, self._start) | {TICK: {"load": 1e-3 * trace[TICK_NS]}}
        recording.curves(
            time_s[kept], {what: {name: line[kept] for name, line in named.items()} for what, named in lines.items()}
        )

    def _trace(self, arms: Sequence[str], rows: Sequence[Row]) -> Mapping[str, Array]:
        """The rows as :func:`sim_server.trace.read_trace` would give them."""
        named = columns(arms, self._limits.joints)
        width = sum(named.values()) - 2  # tick and time stand beside them
        if wrong := next((len(row.values) for row in rows if len(row.values) != 8 * width), None):
            raise Unfitting(
                f"rows of {wrong // 8} numbers came, expected {width} of {len(arms)} arms {self._scenario.team.arm}: "
                "record with the scenario, and the changes to it, that the simulator was started with"
            )
        values = np.frombuffer(b"".join(row.values for row in rows), "<f8").reshape(len(rows), width)
        ticks = np.array([row.tick for row in rows])
        trace: dict[str, Array] = {
            "tick": ticks,
            "time_s": ticks * (self._scenario.clock.control_period_ms / 1000),
            TICK_NS: np.array([row.tick_ns for row in rows], float),
        }
        start = 0
        for name, count in named.items():
            if name not in trace:
                part = values[:, start : start + count]
                trace[name] = part if count > 1 else part[:, 0]
                start += count
        return trace

    def events(self, events: Iterable[Event]) -> None:
        """Record events."""
        for event in events:
            details = json.loads(event.details)
            head = {"tick": event.tick, "time_s": event.time_s, "kind": event.kind}
            self._recording.happened(happening(details | head))
