"""How many messages and bytes crossed the simulator's edge, by agent, key and direction. Two integer adds a message."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from sim_server.snapshot import Snapshot
from wire.link import Publisher

OBSERVERS, OPERATOR, STRANGERS = "observers", "operator", "strangers"
"""Who a row belongs to when it is no agent: names that no arm may have in the table."""

Direction = Literal["to", "from"]


@dataclass(slots=True)
class Tally:
    """One row. Each has one writer: the tick's thread (``to``), or the transport's thread of that key (``from``)."""

    agent: str
    key: str
    direction: Direction
    """Seen from the simulator: ``to`` the agent or ``from`` it."""
    messages: int = 0
    size_bytes: int = 0

    def add(self, payload: bytes) -> None:
        self.messages += 1
        self.size_bytes += len(payload)


class CountedPublisher:
    """A publisher that counts what it puts."""

    __slots__ = ("_put", "_tally", "matched")

    def __init__(self, publisher: Publisher, tally: Tally) -> None:
        self._put, self._tally = publisher.put, tally
        self.matched: Callable[[], bool] = publisher.matched

    def put(self, payload: bytes) -> None:
        tally = self._tally
        tally.messages += 1
        tally.size_bytes += len(payload)
        self._put(payload)


class Tallies:
    """All rows of a run."""

    def __init__(self) -> None:
        self.rows: dict[tuple[str, str, Direction], Tally] = {}

    def of(self, agent: str, key: str, direction: Direction) -> Tally:
        """The row; made when it is asked for first."""
        return self.rows.setdefault((agent, key, direction), Tally(agent, key, direction))

    def state(self) -> Snapshot:
        """All rows."""
        rows = [[row.agent, row.key, row.direction, row.messages, row.size_bytes] for row in list(self.rows.values())]
        return {"rows": rows}

    def restore(self, saved: Snapshot) -> None:
        """Count on from there. Before anybody can send anything, since every row has one writer."""
        for agent, key, direction, messages, size_bytes in saved["rows"]:
            row = self.of(str(agent), str(key), direction)
            row.messages, row.size_bytes = int(messages), int(size_bytes)
