"""The observer behind the dashboard: what arrives is put in queues by the transport's thread, and looked at a few times
a second. A terminal that is slow loses rows here, to this dashboard alone.
"""

from __future__ import annotations

import threading
import time
from typing import Protocol

from deploy.see.heard import Heard, NotSeen
from deploy.see.watch.seen import Seen, look
from wire.keys import Keys
from wire.link import Link
from wire.messages import Event, Progress, Row

LOOK_S = 0.25
"""Wall time between two looks at what has come."""
MOST_ROWS, MOST_EVENTS, MOST_REPORTS = 2000, 2000, 200
"""Messages that wait at most."""
SILENT_S = 2.0
"""Wall time without a word after which the dashboard says so."""


class Screen(Protocol):
    """Where it is shown."""

    def show(self, seen: Seen, warning: str) -> None: ...


class Watcher:
    """Takes in what the simulator tells observers.

    Args:
        link: an observer's.
        run: name of the run.
    """

    def __init__(self, link: Link, run: str) -> None:
        keys = Keys(run)
        self.seen = Seen(run)
        self._rows = Heard(link, keys.rows, Row, MOST_ROWS)
        self._events = Heard(link, keys.events, Event, MOST_EVENTS)
        self._progress = Heard(link, keys.progress, Progress, MOST_REPORTS)
        self._shown_itself, self._wake, self._stopped = threading.Event(), threading.Event(), threading.Event()
        self._gone_since: float | None = None
        self._heard = time.monotonic()
        link.watch_alive(keys.sim_alive, self._watch)

    def _watch(self, is_alive: bool) -> None:
        if is_alive:
            self._gone_since = None
            self._shown_itself.set()
        elif self._shown_itself.is_set():
            self._gone_since = time.monotonic()
            self._wake.set()

    def stop(self) -> None:
        """End with the next look. May be called from a signal."""
        self._stopped.set()
        self._shown_itself.set()
        self._wake.set()

    def wait_for_simulator(self, timeout_s: float) -> None:
        """Raises :class:`NotSeen` if there is none."""
        if not self._shown_itself.wait(timeout_s):
            raise NotSeen(
                f"no simulator of run {self.seen.run} has shown a sign of life within {timeout_s:g} s: start it with "
                "`palanquin sim`, check --run, or wait longer with --wait-s"
            )

    def run_to_end(self, screen: Screen, reconnect_s: float) -> Seen:
        """Show the run until its simulator has ended it and gone, or until :meth:`stop`; what was seen at last.

        Args:
            reconnect_s: wall time that a simulator which has gone without an end gets to come back.

        Raises:
            NotSeen: it has gone, and has not come back.
        """
        while True:
            self._wake.wait(LOOK_S)
            self._wake.clear()
            gone_since, stopped = self._gone_since, self._stopped.is_set()  # before the look, which so misses nothing
            self._take_in()
            gone_s = 0.0 if gone_since is None else time.monotonic() - gone_since
            screen.show(self.seen, self._warning(gone_since is not None, reconnect_s - gone_s))
            if stopped or (gone_since is not None and self.seen.ended is not None):
                return self.seen
            if gone_since is not None and gone_s >= reconnect_s:
                raise NotSeen(
                    f"the simulator of run {self.seen.run} is gone, or cannot be reached any more: its last word was "
                    f"of tick {self.seen.tick} ({self.seen.time_s:.2f} s), and none of an end; see its log"
                )

    @property
    def was_stopped(self) -> bool:
        """Whether somebody asked for the end."""
        return self._stopped.is_set()

    def _warning(self, is_gone: bool, patience_s: float) -> str:
        if self.seen.ended is not None:
            return ""
        if is_gone:
            return f"the simulator is gone, waiting {max(0.0, patience_s):.0f} s for it"
        silent_s = time.monotonic() - self._heard
        return f"no word for {silent_s:.0f} s" if silent_s > SILENT_S else ""

    def _take_in(self) -> None:
        before = self._refused
        progress, rows, events = self._progress.take(), self._rows.take(), self._events.take()
        if rows or events or progress:
            self._heard = time.monotonic()
        self.seen = look(self.seen, rows, events, progress, self._refused - before)

    @property
    def _refused(self) -> int:
        return self._progress.refused + self._rows.refused + self._events.refused
