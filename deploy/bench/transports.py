"""The transports that are measured bare: the hub's side and an agent's, over Zenoh, Unix sockets, and ZeroMQ.

The messages are bytes without meaning, of the length of ours. An agent answers as soon as its transport allows: over
Zenoh on the transport's own thread, as our followers do.
"""

from __future__ import annotations

import importlib
import os
import queue
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

ANSWER_S = 10.0
"""Longer than any answer takes; who waits longer has lost a message."""
CONNECT_S = 60.0
SETTLED_S = 0.3
"""Without an answer: none is on its way any more."""


@dataclass(frozen=True, slots=True)
class Talk:
    """What passes between the hub and one agent."""

    name: str
    """An arm's, or ``leader``."""
    asked_bytes: int
    answered_bytes: int
    every: int = 1
    """Ticks between two messages."""


class Hub(Protocol):
    """The side of the simulator."""

    def wait_for_agents(self) -> None: ...

    def send(self, number: int) -> None:
        """To the agent of this number."""

    def receive(self, numbers: Sequence[int]) -> None:
        """The answers of all these agents."""


class ZenohHub:
    """Over our own link: the same configuration, access rules and passwords as a run."""

    def __init__(self, place: str, talks: Sequence[Talk]) -> None:
        from wire.credentials import STDIN, read_guests
        from wire.keys import Keys
        from wire.zenoh_link import open_server

        link, keys = open_server(place, read_guests(STDIN), "bench"), Keys("bench")
        self._link = link  # whose end would be the session's
        self._inbox: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        own = [keys.leader if talk.name == "leader" else keys.arm(talk.name) for talk in talks]
        self._publishers = [link.publisher(each.state) for each in own]
        self._put: list[Callable[[], None]] = []
        for talk, publisher in zip(talks, self._publishers, strict=True):
            payload = bytes(talk.asked_bytes)
            self._put.append(lambda publisher=publisher, payload=payload: publisher.put(payload))  # type: ignore[misc]  # cannot infer a lambda with defaults
        for each in own:
            link.subscribe(each.command, self._inbox.put)

    def wait_for_agents(self) -> None:
        for publisher in self._publishers:
            _wait(publisher.matched)
        for put in self._put:  # the way back takes a moment longer: until everybody has answered once
            _wait(lambda put=put: self._is_answered(put))  # type: ignore[misc]  # cannot infer a lambda with defaults
        with suppress(queue.Empty):
            while True:  # answers to what was asked twice
                self._inbox.get(timeout=SETTLED_S)

    def _is_answered(self, put: Callable[[], None]) -> bool:
        put()
        try:
            self._inbox.get(timeout=SETTLED_S)
        except queue.Empty:
            return False
        return True

    def send(self, number: int) -> None:
        self._put[number]()

    def receive(self, numbers: Sequence[int]) -> None:
        for _ in numbers:
            self._inbox.get(timeout=ANSWER_S)


def zenoh_agent(place: str, talk: Talk) -> None:
    """Answers on the thread that brings the message; stays until its standard input closes."""
    from wire.credentials import STDIN, read_credential
    from wire.keys import Keys
    from wire.zenoh_link import open_client

    link, keys = open_client(place, read_credential(STDIN)), Keys("bench")
    own = keys.leader if talk.name == "leader" else keys.arm(talk.name)
    publisher, answer = link.publisher(own.command), bytes(talk.answered_bytes)
    link.subscribe(own.state, lambda payload: publisher.put(answer))
    _sit_until_told()


class SocketHub:
    """Over Unix sockets (streams): the floor, as the kernel alone has it."""

    def __init__(self, place: str, talks: Sequence[Talk]) -> None:
        self._talks = talks
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.settimeout(CONNECT_S)
        self._listener.bind(place)
        self._listener.listen(len(talks))
        self._sockets: list[socket.socket] = []
        self._payloads = [bytes(talk.asked_bytes) for talk in talks]

    def wait_for_agents(self) -> None:
        came: dict[str, socket.socket] = {}
        for _ in self._talks:
            connection, _ = self._listener.accept()
            connection.settimeout(None)  # a limit would cost a system call more per message
            came[connection.makefile("r").readline().strip()] = connection
        self._sockets = [came[talk.name] for talk in self._talks]

    def send(self, number: int) -> None:
        self._sockets[number].sendall(self._payloads[number])

    def receive(self, numbers: Sequence[int]) -> None:
        for number in numbers:
            _take(self._sockets[number], self._talks[number].answered_bytes)


def socket_agent(place: str, talk: Talk) -> None:
    """Answers until the hub is gone."""
    own = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    own.connect(place)
    own.sendall(f"{talk.name}\n".encode())
    answer = bytes(talk.answered_bytes)
    with suppress(ConnectionError):
        while True:
            _take(own, talk.asked_bytes)
            own.sendall(answer)


class ZmqHub:
    """Over ZeroMQ (pyzmq), ROUTER and DEALER over TCP on this machine, as our own link is."""

    def __init__(self, place: str, talks: Sequence[Talk]) -> None:
        zmq: Any = importlib.import_module("zmq")
        self._socket = zmq.Context().socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVTIMEO, round(1000 * ANSWER_S))
        self._socket.bind(place)
        self._poll_ms = round(1000 * CONNECT_S)
        self._count = len(talks)
        self._messages = [[talk.name.encode(), bytes(talk.asked_bytes)] for talk in talks]

    def wait_for_agents(self) -> None:
        for _ in range(self._count):
            if not self._socket.poll(self._poll_ms):
                raise TimeoutError("not all agents have connected")
            self._socket.recv_multipart()

    def send(self, number: int) -> None:
        self._socket.send_multipart(self._messages[number])

    def receive(self, numbers: Sequence[int]) -> None:
        for _ in numbers:
            self._socket.recv_multipart()


def zmq_agent(place: str, talk: Talk) -> None:
    """Answers until it is ended."""
    zmq: Any = importlib.import_module("zmq")
    own = zmq.Context().socket(zmq.DEALER)
    own.setsockopt(zmq.IDENTITY, talk.name.encode())
    own.setsockopt(zmq.LINGER, 0)
    own.connect(place)
    own.send(b"here")
    answer = bytes(talk.answered_bytes)
    while True:
        own.recv()
        own.send(answer)


HUBS: dict[str, Callable[[str, Sequence[Talk]], Hub]] = {"zenoh": ZenohHub, "sockets": SocketHub, "zmq": ZmqHub}
AGENTS: dict[str, Callable[[str, Talk], None]] = {"zenoh": zenoh_agent, "sockets": socket_agent, "zmq": zmq_agent}


def _take(own: socket.socket, size: int) -> None:
    """So many bytes."""
    while size:
        got = len(own.recv(size))
        if not got:
            raise ConnectionError("the other side is gone")
        size -= got


def _wait(seen: Callable[[], bool]) -> None:
    deadline = time.monotonic() + CONNECT_S
    while not seen():
        if time.monotonic() > deadline:
            raise TimeoutError("not all agents have connected")
        time.sleep(0.01)


def _sit_until_told() -> None:
    """Until standard input closes."""
    while os.read(0, 4096):
        pass
    os._exit(0)
