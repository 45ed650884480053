"""What the two sides need of a transport. Zenoh fills it (wire/zenoh_link.py), and memory does in tests.

Handlers run on threads of the transport: they hand over and return, and never close or undeclare anything.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Literal, Protocol, Self

Kind = Literal["subscriber", "publisher", "queryable", "token"]


@dataclass(frozen=True, slots=True)
class Declared:
    """That a session of another process wants to hear, say, answer or show something, as the transport knows it."""

    session: str
    """The transport's own number of that session."""
    kind: Kind
    expression: str
    """As the session asked for it; it may hold wildcards."""
    keys: tuple[str, ...]
    """Of the keys that were asked about, those that it reaches."""


@dataclass(frozen=True, slots=True)
class Census:
    """Who is connected, and who has declared what. No agent can answer this for us: the transport does."""

    addresses: dict[str, str]
    """Session to the address that it came from."""
    declared: tuple[Declared, ...]


class Question(Protocol):
    """A query that waits for its one reply; it may be answered from any thread."""

    @property
    def key(self) -> str: ...

    @property
    def payload(self) -> bytes: ...

    def reply(self, payload: bytes) -> None: ...


class Publisher(Protocol):
    """Sends on one key."""

    def put(self, payload: bytes) -> None: ...

    def matched(self) -> bool:
        """Whether a subscriber of this key is connected; what is put before is lost."""
        ...


class Link(Protocol):
    """One session. Everything declared through it ends with it."""

    def publisher(self, key: str) -> Publisher: ...

    def subscribe(self, key: str, handler: Callable[[bytes], None]) -> None: ...

    def answer_queries(self, key_expression: str, handler: Callable[[Question], None]) -> None: ...

    def query(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        """The reply, or None if none came in time."""
        ...

    def declare_alive(self, key: str) -> None:
        """Show a sign of life on ``key`` for as long as this session lives."""
        ...

    def watch_alive(self, key: str, handler: Callable[[bool], None]) -> None:
        """Call ``handler`` with True when a sign of life appears on ``key`` (now, if it is there), with False when it
        goes."""
        ...

    def census(self, keys: Sequence[str]) -> Census | None:
        """Who is connected and has declared what, seen from this session, which itself is left out; None if the
        transport does not tell.

        Only when all else is done, and on a thread that nobody waits for without a limit: if a session comes, goes or
        declares meanwhile, Zenoh may not come back from it, and then the whole link hangs, its ``close`` too.
        """
        ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
