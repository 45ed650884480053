"""What every connection to the simulator carried, counted by the kernel, beside what we meant to send and took in.

A thread of its own counts twice a second, off the tick's path, and asks Zenoh nothing. It also counts as soon as an
agent that was quiet has said enough to be told from a stranger, so that one that dies soon after is known by its bytes.
Each count remembers the tallies of that moment: what a connection may have carried is what was sent while it was there,
and no more.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from sim_server.tally import STRANGERS, Tallies
from sim_server.wiretap import Carried, Wiretap
from wire.endpoints import Endpoint

EVERY_S = 0.5
"""Wall time between two counts; one costs about a millisecond of a core."""
HEED_S = 0.05
"""Wall time between two looks at our own tallies for agents that began to speak; one costs some ten microseconds."""


@dataclass(frozen=True, slots=True)
class Overhead:
    """Most bytes that a connection carries in one direction besides our payloads. Measured; see docs/silence.md."""

    opening: int
    """Handshake, and declarations of keys of ordinary length."""
    per_message: int
    per_s: int
    """Zenoh's own signs of life."""


OVERHEAD: Mapping[str, Overhead] = {"tcp": Overhead(1280, 16, 40), "tls": Overhead(4096, 44, 300)}
"""By protocol."""


@dataclass(frozen=True, slots=True)
class Flow:
    """Messages and bytes of payload."""

    messages: int = 0
    size_bytes: int = 0

    def __sub__(self, other: Flow) -> Flow:
        return Flow(self.messages - other.messages, self.size_bytes - other.size_bytes)

    def __add__(self, other: Flow) -> Flow:
        return Flow(self.messages + other.messages, self.size_bytes + other.size_bytes)


@dataclass(frozen=True, slots=True)
class Moment:
    """What had been counted at our edge at one time, by agent."""

    at_s: float
    to: Mapping[str, Flow]
    taken: Mapping[str, Flow]

    @classmethod
    def of(cls, tallies: Tallies) -> Moment:
        to: dict[str, Flow] = {}
        taken: dict[str, Flow] = {}
        for row in list(tallies.rows.values()):
            flows = to if row.direction == "to" else taken
            flows[row.agent] = flows.get(row.agent, Flow()) + Flow(row.messages, row.size_bytes)
        return cls(time.monotonic(), to, taken)


class Beginnings:
    """Tells when an agent that was quiet, or new, has said ``enough_bytes`` since then."""

    def __init__(self, enough_bytes: int) -> None:
        self._enough = enough_bytes
        self._last: dict[str, int] = {}
        self._quiet_at: dict[str, int] = {}

    def any_in(self, taken: Mapping[str, Flow]) -> bool:
        """Whether it has come to that for anybody since the last call."""
        for name, flow in taken.items():
            if flow.size_bytes == self._last.get(name, 0):
                self._quiet_at[name] = flow.size_bytes
            elif name not in self._last:
                self._quiet_at[name] = 0
            self._last[name] = flow.size_bytes
        began = [name for name, before in self._quiet_at.items() if self._last[name] - before > self._enough]
        for name in began:
            del self._quiet_at[name]
        return bool(began)


@dataclass(slots=True)
class Connection:
    """One connection over its life, as far as it was counted."""

    carried: Carried
    before: Moment
    """A moment at which it was not there yet."""
    sooner: Moment
    """Just before the last count of it."""
    later: Moment
    """Just after."""
    is_there: bool = True

    def explained(self, name: str, overhead: Overhead) -> int:
        """Most bytes to ``name`` that our own messages in its time explain (answers to strangers may be among them)."""
        none = Flow()
        meant = sum(
            (self.later.to.get(who, none) - self.before.to.get(who, none) for who in (name, STRANGERS)), start=none
        )
        return self._with(overhead, meant)

    def explained_from(self, name: str, overhead: Overhead) -> int:
        """The same for what we took in from ``name``."""
        return self._with(overhead, self.later.taken.get(name, Flow()) - self.before.taken.get(name, Flow()))

    def _with(self, overhead: Overhead, meant: Flow) -> int:
        return meant.size_bytes + overhead.per_message * meant.messages + self.besides(overhead)

    def besides(self, overhead: Overhead) -> int:
        """Most bytes that it carries without any message."""
        return overhead.opening + int(overhead.per_s * (self.later.at_s - self.before.at_s))

    def brought(self, name: str) -> int:
        """Fewest bytes that it must have brought if all that ``name`` said in its time came over it."""
        return (self.sooner.taken.get(name, Flow()) - self.before.taken.get(name, Flow())).size_bytes


class Counts(Protocol):
    """Who tells what the connections carry: :class:`sim_server.wiretap.Wiretap`, or a test."""

    def connections(self) -> Sequence[Carried]:
        """All that are there now. Raises ``OSError`` where this cannot be told."""
        ...


class Connections:
    """All connections of a run.

    Args:
        counts: who counts; None if the simulator does not listen itself.
        tallies: of our own edge.
        overhead: of the protocol.
    """

    def __init__(self, counts: Counts | None, tallies: Tallies, overhead: Overhead) -> None:
        self._counts, self._tallies, self.overhead = counts, tallies, overhead
        self._before = Moment.of(tallies)
        self.found: dict[int, Connection] = {}
        self.problem = (
            ""
            if counts
            else "what each connection carried cannot be counted: the simulator does not listen on TCP itself"
        )

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Count now, then on a thread of its own every so often and when agents begin, and once more at the end."""
        if self._counts is None:
            yield
            return
        over = threading.Event()

        def watch() -> None:
            beginnings, last_s = Beginnings(2 * self.overhead.opening), time.monotonic()
            while not over.wait(HEED_S):
                moment = Moment.of(self._tallies)
                if beginnings.any_in(moment.taken) or moment.at_s - last_s >= EVERY_S:
                    self.count()
                    last_s = moment.at_s

        thread = threading.Thread(target=watch, name="wiretap", daemon=True)
        self.count()
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            self.count()

    def count(self) -> None:
        """Take one count. The kernel not telling is remembered as the problem."""
        if self._counts is None or self.problem:
            return
        sooner = Moment.of(self._tallies)
        try:
            carried = self._counts.connections()
        except OSError as error:
            self.problem = f"what each connection carried could not be counted ({error})"
            return
        later = Moment.of(self._tallies)
        there = {each.number for each in carried}
        for number, connection in self.found.items():
            connection.is_there = number in there
        for each in carried:
            known = self.found.get(each.number)
            if known is None:
                self.found[each.number] = Connection(each, self._before, sooner, later)
            else:
                known.carried, known.sooner, known.later = each, sooner, later
        self._before = sooner


def connections_of(listening: Endpoint | None, tallies: Tallies) -> Connections:
    """Those of a listener; without one, or over another protocol than these, nothing is counted."""
    if listening is None or listening.protocol not in OVERHEAD:
        return Connections(None, tallies, OVERHEAD["tcp"])
    return Connections(Wiretap(listening), tallies, OVERHEAD[listening.protocol])
