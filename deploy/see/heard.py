"""What an observer hears: kept until it looks, a few times a second, and lost to it alone where it looks too late."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from sim_server.errors import SimError
from wire.codec import decode
from wire.errors import Refused
from wire.link import Link
from wire.messages import Event, Progress, Row

M = TypeVar("M", Row, Event, Progress)

YIELDS = 10
"""How far an observer steps back (nice) behind those who carry."""


class NotSeen(SimError):
    """No simulator, one that has gone away, or nobody to show it to."""

    exit_status = 3


class Heard(Generic[M]):
    """Messages on one key: the transport's thread puts them in, the observer's own takes them out.

    Args:
        link: an observer's.
        key: on which they come.
        kind: of message.
        most: how many wait at most; the oldest are lost. Without, all of them.
    """

    def __init__(self, link: Link, key: str, kind: type[M], most: int | None = None) -> None:
        self._kind: type[M] = kind
        self._waiting: deque[bytes] = deque(maxlen=most)
        self.refused = 0
        """Messages so far that did not fit."""
        link.subscribe(key, self._waiting.append)

    def take(self) -> list[M]:
        """All that have come since the last time."""
        found: list[M] = []
        for _ in range(len(self._waiting)):
            try:
                found.append(decode(self._waiting.popleft(), self._kind))
            except Refused:
                self.refused += 1
        return found
