"""What must get to the disk while the run goes on: done by one thread, in order, so that no tick waits for a disk.

The first thing that cannot be written ends it: nothing that came after is tried, so what is there is whole up to a
point, and whoever hands over the next thing, or waits for the last, is told.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

from sim_server.errors import SimError

Job = Callable[[], object]
Do = Callable[[Job], None]
"""How something gets done: at once, or by a :class:`Disk`."""

MOST_WAITING = 16
"""Things on their way. A disk that falls further behind holds the ticks up instead of filling the memory."""


class DiskFailed(SimError):
    """What belongs to the run could not be written."""

    exit_status = 3


def at_once(job: Job) -> None:
    """Do it here and now."""
    job()


class Disk:
    """The thread; it begins with the first thing that it is given, and ends with the process."""

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[Job | threading.Event] = queue.SimpleQueue()  # its put never waits for the thread
        self._thread: threading.Thread | None = None
        self._failure: Exception | None = None
        self.took_ns: list[int] = []
        """Wall time of everything done so far."""

    def do(self, job: Job) -> None:
        """Have it done after all that was given before.

        Raises:
            DiskFailed: something given before could not be done.
        """
        self._check()
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="disk", daemon=True)
            self._thread.start()
        if self._jobs.qsize() >= MOST_WAITING:
            self.wait()
        self._jobs.put(job)

    def wait(self) -> None:
        """Until all is done. Raises :class:`DiskFailed` if something could not be."""
        if self._thread is not None:
            done = threading.Event()
            self._jobs.put(done)
            done.wait()
        self._check()

    def _check(self) -> None:
        if self._failure is not None:
            raise DiskFailed(
                f"the run could not be written down: {self._failure}. Make room; `palanquin sim --resume RUN` goes on "
                "from the last checkpoint"
            ) from self._failure

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            if isinstance(job, threading.Event):
                job.set()  # somebody waits for all that came before
                continue
            start = time.perf_counter_ns()
            try:
                if self._failure is None:
                    job()
                    self.took_ns.append(time.perf_counter_ns() - start)
            except Exception as failure:  # whatever it is, the ticks must hear of it
                self._failure = failure
