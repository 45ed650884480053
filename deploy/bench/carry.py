"""A carry through real processes, as ``palanquin run`` has it, that is ended after so much wall time of ticks."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deploy.agents_told import guests_of
from deploy.bench.plan import TeamOf
from deploy.bench.process_cost import Memory, cpu_s_of, memory_of
from deploy.exit_status import COULD_NOT_RUN
from deploy.launcher import Launcher
from deploy.planned_run import as_settings, merged
from deploy.see.viewing import RECORDING
from sim_server.run_folder import read_run
from sim_server.scenario import Scenario
from wire.access import Role
from wire.credentials import Guests
from wire.messages import Progress
from wire.zenoh_link import free_endpoint, open_client

RECORD_EVERY_MS = 10
"""Of a carry that is recorded at 100 Hz."""
LONGEST_S = 600.0
"""Simulated time that a carry may take: more than the wall time that it gets, however fast the machine."""


class CarryFailed(Exception):
    """A carry that was to be measured did not come about."""

    exit_status = COULD_NOT_RUN


class _Enough(Exception):
    """The carry has had its wall time."""


@dataclass(frozen=True, slots=True)
class Carry:
    """What a carry left."""

    ticks: int
    wall_s: float
    """From the first tick to the last."""
    measured: Mapping[str, Any]
    """As in run.json."""
    memory: Mapping[str, Memory]
    """Of every process, in the middle of it."""
    cpu_us: Mapping[str, float]
    """Processor time of every process, us per tick; empty where it is not told."""
    lost: tuple[str, ...]
    """Agents that were lost on the way."""

    @property
    def ticks_per_s(self) -> float:
        """Ticks a second of wall time."""
        return self.ticks / self.wall_s


@dataclass(slots=True)
class Watch:
    """Takes the memory of all processes in the middle of a carry, and their processor times from its first report to
    its last, and ends it when it has had its time."""

    seconds: float
    launcher: BenchLauncher
    memory: dict[str, Memory] = field(default_factory=dict)
    first: tuple[int, dict[str, float]] | None = None
    """Tick and processor times, s."""
    cpu_us: dict[str, float] = field(default_factory=dict)
    """Per tick."""

    def show(self, progress: Progress) -> None:
        """What the launcher calls with every report. Raises :class:`_Enough`."""
        if progress.phase != "running" or not progress.real_time_factor:
            return
        wall_s = progress.time_s / progress.real_time_factor
        if self.first is None:
            self.first = progress.tick, self.launcher.cpu_s()
        if not self.memory and wall_s >= 0.5 * self.seconds:
            self.memory = self.launcher.memory()
        if wall_s >= self.seconds:
            tick, before = self.first
            ticks = progress.tick - tick
            now = self.launcher.cpu_s() if ticks else {}
            self.cpu_us = {name: 1e6 * (used - before.get(name, used)) / ticks for name, used in now.items()}
            raise _Enough


class BenchLauncher(Launcher):
    """A launcher that knows what its processes hold, and can leave out the count of what connections carry."""

    def __init__(
        self,
        arguments: Sequence[str],
        scenario: Scenario,
        endpoint: str,
        folder: Path,
        guests: Guests,
        recorder: Sequence[str],
        *,
        audited: bool,
    ) -> None:
        super().__init__(arguments, scenario, "carry", endpoint, folder, guests, recorder)
        self._audited = audited

    def _sim_access(self) -> tuple[list[str], bytes]:
        arguments, secret = super()._sim_access()
        return [*arguments, *([] if self._audited else ["--uncounted"])], secret

    def memory(self) -> dict[str, Memory]:
        """Of every process that is there, by name."""
        found = {child.name: memory_of(child.process.pid) for child in self._children if child.process.poll() is None}
        return {name: memory for name, memory in found.items() if memory is not None}

    def cpu_s(self) -> dict[str, float]:
        """Processor time of every process that is there so far, s, by name."""
        found = {child.name: cpu_s_of(child.process.pid) for child in self._children if child.process.poll() is None}
        return {name: used for name, used in found.items() if used is not None}


def carry(
    team: TeamOf,
    seconds: float,
    changes: Mapping[str, Any] | None = None,
    *,
    recorded: bool = False,
    audited: bool = True,
) -> Carry:
    """Carry for so much wall time, counted from the first tick, with a process for every arm and the leader.

    Args:
        team: who carries what.
        changes: of the scenario, over the team's.
        recorded: an observer records it meanwhile.
        audited: the simulator counts what every connection carries.

    Raises:
        CarryFailed: a process ended before its time, or nothing was measured.
    """
    named = team.load({**(changes or {}), "duration_s": LONGEST_S})
    scenario = named.scenario
    changed = merged(merged(team.changes, changes or {}), {"duration_s": LONGEST_S})
    arguments = [word for setting in as_settings(changed) for word in ("--set", setting)]
    guests = guests_of(scenario)
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory(prefix="palanquin-") as place:
        folder = Path(place) / "run"
        recorder = ["--save", str(folder / RECORDING)] if recorded else []
        launcher = BenchLauncher(
            [*arguments, "--", team.scenario], scenario, endpoint, folder, guests, recorder, audited=audited
        )
        watch = Watch(seconds, launcher)
        try:
            launcher.start()
            if launcher.sim.process.poll() is not None:
                raise CarryFailed(f"the simulator ended at its start: {launcher.sim.last_words()}")
            with open_client(endpoint, guests.of(Role.OPERATOR)) as link:
                try:
                    ended = launcher.watch(link, watch.show)
                    raise CarryFailed(f"a carry ended before its time: {ended.problem or 'it reached its duration'}")
                except _Enough:
                    launcher.order_stop(link)
            problem = launcher.wait_for_recorder()
            if problem:
                raise CarryFailed(problem)
            run = read_run(folder)
        finally:
            launcher.end_all()
    measured = run["measured"]
    if not run["ended"]["ticks"] or not measured["wall_s"]:
        raise CarryFailed(f"a carry was stopped before its first tick: {run['ended']['why']}")
    lost = tuple(name for name, agent in run["agents"].items() if agent["phase"] == "lost")
    return Carry(int(run["ended"]["ticks"]), float(measured["wall_s"]), measured, watch.memory, watch.cpu_us, lost)
