"""What holds of the link in memory only: at once, on the caller's thread; and its keys match as Zenoh's do."""

from __future__ import annotations

import threading
import time

import pytest
import zenoh
from hypothesis import example, given
from hypothesis import strategies as st

from wire.errors import MisuseError
from wire.keys import ANY_HELLO
from wire.memory import Broker, MemoryQuestion, key_matches

chunks = st.sampled_from(["palanquin", "run", "arm", "a1", "hello"])
keys = st.lists(chunks, min_size=1, max_size=5).map("/".join)
expressions = st.tuples(st.lists(chunks | st.just("*"), min_size=1, max_size=5), st.sampled_from([[], ["**"]])).map(
    lambda parts: "/".join(parts[0] + parts[1])
)


@given(expression=expressions, key=keys)
@example(expression=ANY_HELLO[0], key="palanquin/run/arm/a1/hello")
@example(expression=ANY_HELLO[1], key="palanquin/run/leader/hello")
@example(expression=ANY_HELLO[0], key="palanquin/run/leader/hello")
@example(expression="palanquin/**", key="palanquin")
@example(expression="palanquin/run/**", key="palanquin")
@example(expression="*/run", key="palanquin/run/arm")
def test_keys_match_as_in_zenoh(expression: str, key: str) -> None:
    assert key_matches(expression, key) == zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key))


def test_a_put_has_been_heard_on_the_same_thread_when_it_returns() -> None:
    broker = Broker()
    heard: list[tuple[bytes, int]] = []
    with broker.link() as one, broker.link() as other:
        one.subscribe("key", lambda payload: heard.append((payload, threading.get_ident())))
        other.publisher("key").put(b"1")
        assert heard == [(b"1", threading.get_ident())]


def test_a_handler_may_put_an_answer() -> None:
    """A follower's loop in one thread: a state comes in, the command goes out before ``put`` returns."""
    broker = Broker()
    answers: list[bytes] = []
    with broker.link() as simulator, broker.link() as agent:
        command = agent.publisher("command")
        agent.subscribe("state", lambda payload: command.put(b"answer to " + payload))
        simulator.subscribe("command", answers.append)
        simulator.publisher("state").put(b"12")
        assert answers == [b"answer to 12"]


def test_a_query_does_not_wait_for_a_reply_that_cannot_come() -> None:
    broker = Broker()
    with broker.link() as one, broker.link() as other:
        one.answer_queries("key", lambda question: None)
        start = time.monotonic()
        assert other.query("key", b"", timeout_s=60.0) is None
        assert time.monotonic() - start < 10.0


def test_the_first_reply_counts() -> None:
    broker = Broker()

    def reply_twice(question: MemoryQuestion) -> None:
        question.reply(b"first")
        question.reply(b"second")

    with broker.link() as one, broker.link() as other:
        one.answer_queries("key", lambda question: None)
        one.answer_queries("key", reply_twice)
        assert other.query("key", b"", 0.0) == b"first"


def test_two_brokers_are_two_worlds() -> None:
    here, there = Broker(), Broker()
    heard: list[bytes] = []
    with here.link() as one, there.link() as other:
        one.subscribe("key", heard.append)
        one.answer_queries("key", lambda question: question.reply(b"here"))
        one.declare_alive("alive")
        publisher = other.publisher("key")
        publisher.put(b"there")
        other.watch_alive("alive", lambda alive: heard.append(b"alive"))
        assert not publisher.matched()
        assert other.query("key", b"", 0.0) is None
        assert heard == []


def test_use_after_close_is_misuse() -> None:
    link = Broker().link()
    publisher = link.publisher("key")
    link.close()
    with pytest.raises(MisuseError, match="closed"):
        publisher.put(b"")
    with pytest.raises(MisuseError, match="closed"):
        link.publisher("key")
