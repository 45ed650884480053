"""The recorder: an observer, a process of its own. It takes in what the simulator tells and writes it in blocks.

What arrives is put in a queue by the transport's thread; everything else happens here, a few times a second. A viewer,
or a disk, that is slow makes the queue longer, and at its end rows are lost, to this recording alone.
"""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from deploy.launcher import RECORDING_NOW
from deploy.see.heard import YIELDS, Heard, NotSeen
from deploy.see.live import LiveRun
from deploy.see.recording import Recording
from deploy.see.viewing import viewer_command
from sim_server.scenario_files import NamedScenario
from wire.endpoints import parse_endpoint
from wire.keys import Keys
from wire.link import Link
from wire.messages import Event, Row
from wire.zenoh_link import free_endpoint

LOOK_S = 0.2
"""Wall time between two looks at what has come."""
FILE_ROWS, VIEWER_ROWS = 1000, 1
"""Rows that a block has at least. A file of many small blocks is several times as large, and slow to open."""
MOST_WAITING = 20_000
"""Rows that wait at most: 100 simulated seconds of the usual 200 a second."""
VIEWER_S = 30.0
"""Time that a viewer gets to open."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """What came of it."""

    rows: int
    lost: int
    """Rows that are missing between those that came."""
    refused: int
    """Messages that did not fit."""
    viewer_hangs: bool = False
    """It did not take all: leave the process at once."""


class Recorder:
    """Takes in rows and events, and hands them on in blocks.

    Args:
        link: an observer's.
        run: name of the run.
        every_ticks: ticks from one row to the next.
    """

    def __init__(self, link: Link, run: str, every_ticks: int) -> None:
        self._every_ticks = every_ticks
        self._seen, self._over = threading.Event(), threading.Event()
        keys = Keys(run)
        self._rows, self._events = Heard(link, keys.rows, Row, MOST_WAITING), Heard(link, keys.events, Event)
        link.watch_alive(keys.sim_alive, self._watch)

    def _watch(self, is_alive: bool) -> None:
        if is_alive:
            self._seen.set()
        elif self._seen.is_set():
            self._over.set()

    def stop(self) -> None:
        """End after what has come so far."""
        self._over.set()

    def wait_for_simulator(self, timeout_s: float) -> None:
        """Raises :class:`NotSeen` if there is none."""
        if not self._seen.wait(timeout_s):
            raise NotSeen(
                "no simulator of this run shows a sign of life: start it with `palanquin sim`, or check --run"
            )

    def run_to_end(self, lives: Mapping[LiveRun, int]) -> Recorded:
        """Record until the simulator has gone.

        Args:
            lives: where it goes, each with the rows that a block has there at least.

        Raises:
            Unfitting: the simulator runs something else.
        """
        pending: dict[LiveRun, list[Row]] = {live: [] for live in lives}
        count, lost, last = 0, 0, None
        while True:
            over = self._over.wait(LOOK_S)
            rows, events = self._rows.take(), self._events.take()
            for live, least in lives.items():
                pending[live] += rows
                if pending[live] and (over or len(pending[live]) >= least):
                    live.rows(pending[live])
                    pending[live] = []
                live.events(events)
            for row in rows:
                lost += 0 if last is None else max(0, (row.tick - last) // self._every_ticks - 1)
                last = row.tick
            count += len(rows)
            if over:
                return Recorded(count, lost, self._rows.refused + self._events.refused)


def record(
    recorder: Recorder, named: NamedScenario, *, file: Path | None, viewer: str | None, wait_s: float
) -> Recorded:
    """Record a run from now until its simulator has gone.

    Args:
        recorder: takes in what the simulator tells.
        named: the scenario that the simulator was started with.
        file: where the recording goes.
        viewer: address of a viewer that is there.
        wait_s: wall time that the simulator gets to show itself.

    Raises:
        NotSeen: there is no simulator.
        Unfitting: the simulator runs something else.
    """
    recorder.wait_for_simulator(wait_s)
    os.nice(YIELDS)
    part = file.with_name(f"{file.name}.part") if file is not None else None
    places: list[tuple[Path | None, str | None, int]] = [(part, None, FILE_ROWS)] if part is not None else []
    places += [(None, viewer, VIEWER_ROWS)] if viewer is not None else []
    name = f"{named.name}, seed {named.scenario.seed}"
    recordings = [Recording(name, file=to_file, viewer=to_viewer) for to_file, to_viewer, _ in places]
    lives = {
        LiveRun(named.scenario, recording): least for recording, (_, _, least) in zip(recordings, places, strict=True)
    }
    print(RECORDING_NOW, flush=True)
    done, taken = Recorded(0, 0, 0), True
    try:
        done = recorder.run_to_end(lives)
    finally:
        for recording in recordings:  # the file is the first
            taken = recording.close() and taken
            if part is not None and file is not None and part.exists():
                os.replace(part, file)
    return replace(done, viewer_hangs=not taken)


def open_viewer() -> str:
    """Open a viewer, which stays when this process ends; its address.

    Raises:
        NotSeen: it does not open.
    """
    command = viewer_command()
    place = parse_endpoint(free_endpoint())
    process = subprocess.Popen(
        [*command, "--port", str(place.port), "--hide-welcome-screen"],
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + VIEWER_S
    while not place.somebody_listens():
        if process.poll() is not None:
            raise NotSeen(f"the viewer ended with status {process.returncode}; what it said is above")
        if time.monotonic() > deadline:
            process.kill()
            raise NotSeen(f"the viewer has not opened within {VIEWER_S:g} s")
        time.sleep(0.05)
    return f"rerun+http://127.0.0.1:{place.port}/proxy"
