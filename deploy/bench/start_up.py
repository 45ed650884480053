"""Start-up: from the command to the first tick, and from a follower's process to its first command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from deploy.bench.carry import CarryFailed
from deploy.bench.figures import Part, Samples
from deploy.bench.plan import Plan, arms_text, team_of
from deploy.launcher import child_environment
from deploy.planned_run import as_settings, merged
from sim_server.run_folder import EVENTS

POLL_S = 0.002
END_S = 120.0
KILLED_S, STARTED_S, DURATION_S = 0.05, 0.1, 0.15
"""Simulated times: an arm's process is killed, started again, and answers a few ticks more."""
IMPORTS = "import agents.follower, deploy.walls, wire.zenoh_link"
"""What a follower loads before it does anything."""


class EventClock(threading.Thread):
    """Notes when each line of a run's events file came, by this process's clock: lock-step time stands still."""

    def __init__(self, file: Path) -> None:
        super().__init__(name="event clock", daemon=True)
        self._file, self._over = file, threading.Event()
        self.seen: list[tuple[float, Mapping[str, Any]]] = []

    def run(self) -> None:
        done = 0
        while not self._over.wait(POLL_S):
            now = time.perf_counter()
            try:
                data = self._file.read_bytes()
            except FileNotFoundError:
                continue
            whole = data.rfind(b"\n") + 1
            self.seen += [(now, json.loads(line)) for line in data[done:whole].splitlines()]
            done = whole

    def stop(self) -> None:
        """After one more look."""
        time.sleep(2 * POLL_S)
        self._over.set()
        self.join()

    def at(self, kind: str, **details: object) -> float:
        """When the first such line came. Raises :class:`CarryFailed`."""
        for moment, event in self.seen:
            if event["kind"] == kind and all(event.get(name) == value for name, value in details.items()):
                return moment
        raise CarryFailed(f"the run that was to be timed told of no {kind!r} {details}")


def measure_start_up(plan: Plan, tell: Callable[[str], None]) -> Part:
    """A whole command each turn, with an arm that is killed and started again; and Python alone."""
    samples, column = Samples(), arms_text(plan.team)
    for k in range(plan.turns):
        tell(f"turn {k + 1} of {plan.turns}")
        python_s, imports_s = seconds_of("pass"), seconds_of(IMPORTS)
        found = timed_run(plan.team)
        samples.add("python -c pass", column, "s", python_s, "less")
        samples.add("a follower's imports", column, "s", imports_s, "less")
        for name, seconds in found.items():
            samples.add(name, column, "s", seconds, "less")
        samples.ratio("first tick / imports", column, found[FIRST_TICK], imports_s, "less")
        samples.ratio("join / imports", column, found[JOIN], imports_s, "less")
    said = (
        "Join: a follower's process is started in a run whose clock waits for it, until it is let in; it answers that "
        "very tick. Imports: what a follower loads. All files are in the page cache from the second turn on.",
    )
    return Part("start-up", "Start-up", samples.figures(), said)


FIRST_TICK, JOIN, WHOLE = "to the first tick", "join to first command", "whole command, 150 ticks"


def timed_run(arms: int) -> dict[str, float]:
    """Wall times of one ``palanquin run``, s."""
    team = team_of(arms)
    events = [
        {"at_s": KILLED_S, "kind": "kill", "agent": "a1"},
        {"at_s": STARTED_S, "kind": "start", "agent": "a1"},
    ]
    changes = merged(team.changes, {"duration_s": DURATION_S, "events": events})
    with tempfile.TemporaryDirectory(prefix="palanquin-") as place:
        folder = Path(place) / "run"
        command = [sys.executable, "-m", "deploy.cli", "run", team.scenario, "--no-picture", "--out", str(folder)]
        command += [word for setting in as_settings(changes) for word in ("--set", setting)]
        clock = EventClock(folder / EVENTS)
        clock.start()
        start = time.perf_counter()
        try:
            said = _ended(command)
        finally:
            end = time.perf_counter()
            clock.stop()
    if said:
        raise CarryFailed(f"the run that was to be timed did not come to its end: {said}")
    started = clock.at("ordered", event="start", agent="a1")
    return {
        FIRST_TICK: clock.at("started") - start,
        JOIN: clock.at("seen", event="start", agent="a1") - started,
        WHOLE: end - start,
    }


def _ended(command: list[str]) -> str:
    """Run it to its end; the last line that it says if its run has no verdict, which one of so few ticks may well be
    violated."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=child_environment(os.environ),
    )
    try:
        _, said = process.communicate(timeout=END_S)
    except subprocess.TimeoutExpired:
        return f"it took more than {END_S:g} s"
    finally:
        process.terminate()
        process.wait()
    lines = said.decode(errors="replace").split("\n")
    return "" if process.returncode in (0, 1) else next((line for line in reversed(lines) if line), "it said nothing")


def seconds_of(code: str) -> float:
    """Wall time of a Python that runs this."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, env=child_environment(os.environ))
    return time.perf_counter() - start
