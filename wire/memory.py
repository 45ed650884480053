"""The in-memory twin of the transport: one broker, any number of links, same promises, no sockets. For tests.

Delivery is immediate and on the caller's thread; what is put without a subscriber is lost, as on the real thing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from wire.errors import MisuseError
from wire.link import Census, Declared, Kind


def key_matches(expression: str, key: str) -> bool:
    """Whether ``key`` is in ``expression``, in which ``*`` stands for one chunk and a final ``**`` for any number."""
    chunks, parts = expression.split("/"), key.split("/")
    if chunks[-1] == "**":
        chunks = chunks[:-1]
        parts = parts[: len(chunks)]
    return len(chunks) == len(parts) and all(c in ("*", p) for c, p in zip(chunks, parts, strict=True))


class Broker:
    """Where the links of one test meet."""

    def __init__(self) -> None:
        self.subscribers: list[tuple[MemoryLink, str, Callable[[bytes], None]]] = []
        self.queryables: list[tuple[MemoryLink, str, Callable[[MemoryQuestion], None]]] = []
        self.watchers: list[tuple[MemoryLink, str, Callable[[bool], None]]] = []
        self.tokens: list[tuple[MemoryLink, str]] = []
        self.publishers: list[tuple[MemoryLink, str]] = []

    def link(self) -> MemoryLink:
        """A new session."""
        return MemoryLink(self)


class MemoryQuestion:
    """A query on its way; keeps its reply."""

    def __init__(self, key: str, payload: bytes) -> None:
        self.key, self.payload = key, payload
        self.replies: list[bytes] = []

    def reply(self, payload: bytes) -> None:
        self.replies.append(payload)


class MemoryPublisher:
    """Sends on one key."""

    def __init__(self, link: MemoryLink, broker: Broker, key: str) -> None:
        self._link, self._broker, self._key = link, broker, key

    def put(self, payload: bytes) -> None:
        self._link.check_open()
        for _, expression, handler in tuple(self._broker.subscribers):
            if key_matches(expression, self._key):
                handler(payload)

    def matched(self) -> bool:
        return self._link.is_open and any(
            key_matches(expression, self._key) for _, expression, _ in self._broker.subscribers
        )


class MemoryLink:
    """One session at the broker."""

    def __init__(self, broker: Broker) -> None:
        self._broker = broker
        self.is_open = True

    def check_open(self) -> None:
        """Raises :class:`MisuseError` if this session has ended."""
        if not self.is_open:
            raise MisuseError("the link is closed")

    def publisher(self, key: str) -> MemoryPublisher:
        self.check_open()
        self._broker.publishers.append((self, key))
        return MemoryPublisher(self, self._broker, key)

    def subscribe(self, key: str, handler: Callable[[bytes], None]) -> None:
        self.check_open()
        self._broker.subscribers.append((self, key, handler))

    def answer_queries(self, key_expression: str, handler: Callable[[MemoryQuestion], None]) -> None:
        self.check_open()
        self._broker.queryables.append((self, key_expression, handler))

    def query(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        """The first reply; ``timeout_s`` is not waited for, since here a handler replies at once or never."""
        self.check_open()
        for _, expression, handler in tuple(self._broker.queryables):
            if key_matches(expression, key):
                question = MemoryQuestion(key, payload)
                handler(question)
                if question.replies:
                    return question.replies[0]
        return None

    def declare_alive(self, key: str) -> None:
        self.check_open()
        first = all(token != key for _, token in self._broker.tokens)
        self._broker.tokens.append((self, key))
        if first:
            self._tell(key, True)

    def watch_alive(self, key: str, handler: Callable[[bool], None]) -> None:
        self.check_open()
        self._broker.watchers.append((self, key, handler))
        if any(token == key for _, token in self._broker.tokens):
            handler(True)

    def _tell(self, key: str, alive: bool) -> None:
        for _, watched, handler in tuple(self._broker.watchers):
            if watched == key:
                handler(alive)

    def census(self, keys: Sequence[str]) -> Census | None:
        broker = self._broker
        found: list[tuple[MemoryLink, Kind, str]] = [
            *((owner, "subscriber", expression) for owner, expression, _ in broker.subscribers),
            *((owner, "publisher", key) for owner, key in broker.publishers),
            *((owner, "queryable", expression) for owner, expression, _ in broker.queryables),
            *((owner, "token", key) for owner, key in broker.tokens),
        ]
        declared = tuple(
            Declared(str(id(owner)), kind, expression, tuple(key for key in keys if key_matches(expression, key)))
            for owner, kind, expression in found
            if owner is not self
        )
        return Census({each.session: "memory" for each in declared}, declared)

    def close(self) -> None:
        """End the session: its declarations go, and those who watch its tokens are told."""
        self.is_open = False
        broker = self._broker
        broker.subscribers = [entry for entry in broker.subscribers if entry[0] is not self]
        broker.queryables = [entry for entry in broker.queryables if entry[0] is not self]
        broker.watchers = [entry for entry in broker.watchers if entry[0] is not self]
        broker.publishers = [entry for entry in broker.publishers if entry[0] is not self]
        gone = [key for owner, key in broker.tokens if owner is self]
        broker.tokens = [entry for entry in broker.tokens if entry[0] is not self]
        still = {key for _, key in broker.tokens}
        for key in gone:
            if key not in still:
                self._tell(key, False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
