"""What the simulator and the agents may rely on in a link: the same tests for memory and for Zenoh."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from typing import Protocol

import psutil
import pytest
import zenoh

from wire.errors import LinkError, MisuseError
from wire.keys import ANY_HELLO, Keys
from wire.link import Link, Question
from wire.memory import Broker
from wire.zenoh_link import ZenohLink, free_endpoint, open_client, open_server

KEYS = Keys("contract")
A, B = KEYS.arm("a1"), KEYS.arm("a2")
CLOSED = (MisuseError, zenoh.ZError)
"""What a closed link raises: memory the first, Zenoh the second."""
PATIENCE_S = 10.0
"""Deadline for what takes milliseconds: long enough for any machine, and reached only by a failure."""


def until(condition: Callable[[], object], what: str) -> None:
    """Wait until the condition holds; fail with ``what`` when it never does."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {PATIENCE_S:g} s: {what}"
        time.sleep(0.002)


class Network(Protocol):
    """Where links of one kind meet."""

    @property
    def server(self) -> Link: ...

    def client(self) -> Link: ...


class MemoryNetwork:
    def __init__(self, stack: ExitStack) -> None:
        self._stack, self._broker = stack, Broker()
        self.server: Link = stack.enter_context(self._broker.link())

    def client(self) -> Link:
        return self._stack.enter_context(self._broker.link())


class ZenohNetwork:
    def __init__(self, stack: ExitStack) -> None:
        self._stack, self._endpoint = stack, free_endpoint()
        self.server: Link = stack.enter_context(open_server(self._endpoint))

    def client(self) -> Link:
        return self._stack.enter_context(open_client(self._endpoint))


@pytest.fixture(params=["memory", pytest.param("zenoh", marks=pytest.mark.system)])
def network(request: pytest.FixtureRequest) -> Iterator[Network]:
    with ExitStack() as stack:
        yield MemoryNetwork(stack) if request.param == "memory" else ZenohNetwork(stack)


# Publishers and subscribers


@pytest.mark.parametrize("direction", ["server_to_client", "client_to_server"])
def test_a_put_reaches_the_subscriber_of_its_key_and_nobody_else(network: Network, direction: str) -> None:
    sender, receiver = network.server, network.client()
    if direction == "client_to_server":
        sender, receiver = receiver, sender
    other = network.client()
    heard: dict[str, list[bytes]] = {key: [] for key in (A.state, A.command, A.hello, B.state)}
    for key in (A.state, A.command, A.hello):
        receiver.subscribe(key, heard[key].append)
    other.subscribe(B.state, heard[B.state].append)
    publisher = sender.publisher(A.state)
    last = {key: sender.publisher(key) for key in (A.command, A.hello, B.state)}
    for each in (publisher, *last.values()):
        until(each.matched, "the subscriber is matched")
    publisher.put(b"for a1")
    until(partial(heard.get, A.state), "the put arrives")
    for key, each in last.items():  # what they should not hear would have come before this
        each.put(b"last")
        until(partial(heard.get, key), "the last put arrives")
    assert heard == {A.state: [b"for a1"], A.command: [b"last"], A.hello: [b"last"], B.state: [b"last"]}


def test_every_subscriber_of_a_key_hears_it(network: Network) -> None:
    first: list[bytes] = []
    second: list[bytes] = []
    network.client().subscribe(A.state, first.append)
    client = network.client()
    client.subscribe(A.state, second.append)
    publisher = network.server.publisher(A.state)

    def both_heard() -> bool:
        publisher.put(b"x")  # again and again, since matched() speaks of one subscriber only
        return bool(first and second)

    until(both_heard, "both have heard it")


def test_a_put_before_matching_is_lost_and_matched_tells(network: Network) -> None:
    heard: list[bytes] = []
    publisher = network.server.publisher(A.state)
    assert not publisher.matched()
    publisher.put(b"early")
    client = network.client()
    assert not publisher.matched(), "a client that does not subscribe is no match"
    client.subscribe(B.state, heard.append)
    client.subscribe(A.state, heard.append)
    until(publisher.matched, "the subscriber is matched")
    publisher.put(b"late")
    until(lambda: heard, "the put arrives")
    assert heard == [b"late"]
    client.close()
    until(lambda: not publisher.matched(), "the subscriber's end is noticed")


def test_puts_one_at_a_time_all_arrive_whole(network: Network) -> None:
    """One at a time, as the ticks are: of a burst, Zenoh drops what its queue has no room for on a busy machine."""
    heard: list[bytes] = []
    network.server.subscribe(A.command, heard.append)
    publisher = network.client().publisher(A.command)
    until(publisher.matched, "the subscriber is matched")
    sent = [b"", b"\0\xff\n", bytes(range(256)) * 32, *(str(k).encode() for k in range(200))]
    for payload in sent:
        publisher.put(payload)
        until(lambda: heard, "the put arrives")
        assert heard == [payload]
        heard.clear()


# Queries


def test_a_query_gets_its_reply(network: Network) -> None:
    asked: list[tuple[str, bytes]] = []

    def reply(question: Question) -> None:
        asked.append((question.key, question.payload))
        question.reply(b"re: " + question.payload)

    network.server.answer_queries(A.hello, reply)
    client = network.client()
    assert client.query(A.hello, b"hello", PATIENCE_S) == b"re: hello"
    assert client.query(A.hello, b"", PATIENCE_S) == b"re: "
    assert asked == [(A.hello, b"hello"), (A.hello, b"")]


def test_a_query_that_nobody_answers_returns_none_without_waiting(network: Network) -> None:
    network.server.answer_queries(B.hello, lambda question: question.reply(b"wrong door"))
    client = network.client()
    start = time.monotonic()
    assert client.query(A.hello, b"hello", PATIENCE_S) is None
    assert time.monotonic() - start < PATIENCE_S / 2


def test_a_question_that_is_left_open_returns_none_in_time(network: Network) -> None:
    kept: list[Question] = []
    network.server.answer_queries(A.hello, kept.append)
    start = time.monotonic()
    assert network.client().query(A.hello, b"hello", 0.2) is None
    assert time.monotonic() - start < PATIENCE_S / 2
    assert [question.payload for question in kept] == [b"hello"]
    kept[0].reply(b"too late")  # is no error


def test_one_star_answers_for_every_run_and_arm_and_no_deeper(network: Network) -> None:
    for expression in ANY_HELLO:
        network.server.answer_queries(expression, lambda question: question.reply(question.key.encode()))
    client = network.client()
    other = Keys("another-run")
    for key in (A.hello, B.hello, KEYS.leader.hello, other.arm("a9").hello, other.leader.hello):
        assert client.query(key, b"", PATIENCE_S) == key.encode()
    for key in (A.state, KEYS.order, "palanquin/contract/arm/hello", "palanquin/contract/arm/a/1/hello"):
        assert client.query(key, b"", PATIENCE_S) is None


# Signs of life


def test_a_sign_of_life_is_told_when_it_comes_and_when_it_goes(network: Network) -> None:
    told: list[bool] = []
    others: list[bool] = []
    network.server.watch_alive(A.alive, told.append)
    network.server.watch_alive(B.alive, others.append)
    for _ in range(2):  # and again for the next instance
        told.clear()
        agent = network.client()
        agent.declare_alive(A.alive)
        until(lambda: told, "the sign of life is told")
        assert told == [True]
        agent.close()
        until(lambda: len(told) > 1, "its loss is told")
        assert told == [True, False]
    assert others == []


def test_a_late_watcher_is_told_of_a_sign_of_life_that_is_there(network: Network) -> None:
    """An agent looks for the simulator's, which was there first."""
    network.server.declare_alive(KEYS.sim_alive)
    told: list[bool] = []
    network.client().watch_alive(KEYS.sim_alive, told.append)
    until(lambda: told, "the sign of life is told")
    assert told == [True]
    network.server.close()
    until(lambda: len(told) > 1, "its loss is told")
    assert told == [True, False]


def test_two_signs_of_life_on_one_key_are_one_until_the_last_goes(network: Network) -> None:
    """An old instance that hangs, and dies after the new one is in, must not take the new one with it."""
    told: list[bool] = []
    network.server.watch_alive(A.alive, told.append)
    network.server.answer_queries(A.hello, lambda question: question.reply(b"heard"))
    old, new = network.client(), network.client()
    old.declare_alive(A.alive)
    old.subscribe(A.state, lambda payload: None)
    publisher = network.server.publisher(A.state)
    until(lambda: told and publisher.matched(), "the old instance is connected")
    new.declare_alive(A.alive)
    assert new.query(A.hello, b"", PATIENCE_S) == b"heard"  # and so was the sign of life before it
    old.close()
    until(lambda: not publisher.matched(), "the end of the old instance is noticed")
    assert told == [True]
    new.close()
    until(lambda: len(told) > 1, "the loss of the last is told")
    assert told == [True, False]


# The end of a link


def test_everything_declared_through_a_link_ends_with_it(network: Network) -> None:
    heard: list[bytes] = []
    client, asker = network.client(), network.client()
    client.subscribe(A.state, heard.append)
    client.answer_queries(A.hello, lambda question: question.reply(b"here"))
    publisher = network.server.publisher(A.state)
    until(publisher.matched, "the subscriber is matched")
    until(lambda: asker.query(A.hello, b"", 1.0) == b"here", "the queryable is known")
    with client:
        pass
    until(lambda: not publisher.matched(), "the subscriber is gone")
    until(lambda: asker.query(A.hello, b"", 1.0) is None, "the queryable is gone")
    publisher.put(b"to nobody")
    assert heard == []


def test_a_closed_link_refuses_to_work_and_may_be_closed_again(network: Network) -> None:
    heard: list[bytes] = []
    network.server.subscribe(A.command, heard.append)
    client = network.client()
    publisher = client.publisher(A.command)
    until(publisher.matched, "the subscriber is matched")
    client.close()
    assert not publisher.matched()
    for call in (
        lambda: publisher.put(b"from the grave"),
        lambda: client.publisher(A.command),
        lambda: client.subscribe(A.state, heard.append),
        lambda: client.answer_queries(A.hello, lambda question: question.reply(b"")),
        lambda: client.query(A.hello, b"", 0.1),
        lambda: client.declare_alive(A.alive),
        lambda: client.watch_alive(A.alive, lambda _: None),
    ):
        with pytest.raises(CLOSED):
            call()
    client.close()
    assert heard == []


# Zenoh only: sockets


def port_of(endpoint: str) -> int:
    return int(endpoint.rpartition(":")[2])


@pytest.mark.system
def test_a_port_in_use_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(LinkError, match=f"port {port} is in use"):
            open_server(f"tcp/127.0.0.1:{port}")


@pytest.mark.system
def test_a_second_server_finds_the_port_in_use_until_the_first_has_closed() -> None:
    endpoint = free_endpoint()
    with open_server(endpoint), pytest.raises(LinkError, match=f"port {port_of(endpoint)} is in use"):
        open_server(endpoint)
    with open_server(endpoint), open_client(endpoint):
        pass
    open_server(endpoint).close()  # at once, in spite of the connection just closed


@pytest.mark.system
def test_nobody_there_is_told_in_about_the_timeout() -> None:
    endpoint = free_endpoint()
    start = time.monotonic()
    with pytest.raises(LinkError, match=f"nobody answers at {endpoint}"):
        open_client(endpoint, timeout_s=0.3)
    assert 0.25 < time.monotonic() - start < 3.0  # not at once: the simulator may be starting; the rest is slack


@pytest.mark.system
def test_an_agent_may_start_before_its_simulator() -> None:
    endpoint = free_endpoint()
    opened: list[ZenohLink] = []
    thread = threading.Thread(target=lambda: opened.append(open_client(endpoint, timeout_s=PATIENCE_S)))
    thread.start()
    with open_server(endpoint) as server:
        thread.join()
        with opened[0] as client:
            server.answer_queries(A.hello, lambda question: question.reply(b"welcome"))
            until(lambda: client.query(A.hello, b"", 1.0) == b"welcome", "the simulator answers")


BAD = ("", "nonsense", "tcp", "tcp/", "127.0.0.1:7447", "tcp/127.0.0.1", "tcp/:7447", "/127.0.0.1:7447")
BAD_PORTS = ("", "x", "-1", "0", "65536", "99999", "7447x", "74 47", "²", "٣٣٣٣")


@pytest.mark.parametrize("endpoint", [*BAD, *(f"tcp/127.0.0.1:{port}" for port in BAD_PORTS)])
@pytest.mark.parametrize("opens", [open_server, open_client])
def test_a_bad_address_is_told_at_once(opens: Callable[[str], ZenohLink], endpoint: str) -> None:
    with pytest.raises(LinkError, match="bad address") as error:
        opens(endpoint)
    assert repr(endpoint) in str(error.value)


@pytest.mark.parametrize("host", ["no.such.host.invalid", "a" * 64, "..", "a\0b"])
def test_a_host_that_cannot_be_is_told(host: str) -> None:
    with pytest.raises(LinkError, match="bad address"):
        open_server(f"tcp/{host}:7447")


@pytest.mark.system
def test_an_address_of_another_machine_is_told() -> None:
    """192.0.2.1 is reserved for documentation: it is nobody's."""
    with pytest.raises(LinkError, match=r"cannot listen on tcp/192\.0\.2\.1:7447"):
        open_server("tcp/192.0.2.1:7447")


@pytest.mark.system
def test_an_unknown_protocol_is_told() -> None:
    with pytest.raises(LinkError, match=r"bad address .pigeon/.*expected tcp/"):
        open_server("pigeon/127.0.0.1:7447")


def sockets_that_wait() -> set[tuple[str, int]]:
    """Address and port of this process's sockets that anybody could reach: TCP that listens, and all UDP."""
    found = psutil.Process().net_connections(kind="inet")
    return {
        (each.laddr.ip, each.laddr.port)
        for each in found
        if each.laddr and (each.type == socket.SOCK_DGRAM or each.status == psutil.CONN_LISTEN)
    }


@pytest.mark.system
def test_only_the_simulator_listens_on_its_one_port_and_nobody_scouts() -> None:
    """Agents that neither listen nor scout cannot find each other."""
    before = sockets_that_wait()
    endpoint = free_endpoint()
    with open_server(endpoint), open_client(endpoint), open_client(endpoint):
        assert sockets_that_wait() - before == {("127.0.0.1", port_of(endpoint))}
