"""What stands in a link that a scenario cuts: bytes pass as they are, a cut is heard at both ends, and it heals."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from processes import wait_until

from deploy.deeds import Processes
from deploy.relay import Relay
from sim_server.scenario_files import load_scenario
from wire.endpoints import parse_endpoint
from wire.messages import Deed

PATIENCE_S = 20.0
QUIET_S = 0.3
"""Without a byte: on this machine's own line one takes a millisecond."""


@contextmanager
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        yield server


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with listener() as found:
        yield found


@pytest.fixture
def relay(server: socket.socket) -> Iterator[Relay]:
    found = Relay(f"tcp/127.0.0.1:{server.getsockname()[1]}")
    yield found
    found.close()


def connect(relay: Relay) -> socket.socket:
    place = parse_endpoint(relay.endpoint)
    return socket.create_connection((place.host, place.port), PATIENCE_S)


def test_bytes_pass_both_ways_as_they_are(server: socket.socket, relay: Relay) -> None:
    everything = bytes(range(256)) * 1000
    with connect(relay) as near, server.accept()[0] as far:
        for source, sink in ((near, far), (far, near)):
            sink.settimeout(PATIENCE_S)
            source.sendall(everything)
            came = b""
            while len(came) < len(everything):
                came += sink.recv(65536)
            assert came == everything


def test_a_cut_ends_the_connection_at_both_ends_and_nobody_gets_through_until_it_is_restored(
    server: socket.socket, relay: Relay
) -> None:
    with connect(relay) as near, server.accept()[0] as far:
        for each in (near, far):
            each.settimeout(PATIENCE_S)
        near.sendall(b"here")
        assert far.recv(10) == b"here"
        assert relay.cut() == 1
        assert near.recv(10) == far.recv(10) == b""
    with connect(relay) as turned_away:
        assert turned_away.recv(10) == b""
    server.settimeout(0.1)
    with pytest.raises(TimeoutError):
        server.accept()  # the simulator does not hear of who was turned away
    relay.restore()
    server.settimeout(PATIENCE_S)
    with connect(relay) as near, server.accept()[0] as far:
        far.settimeout(PATIENCE_S)
        near.sendall(b"again")
        assert far.recv(10) == b"again"


def test_a_silent_link_stays_open_and_carries_nothing_not_even_an_end(server: socket.socket, relay: Relay) -> None:
    near = connect(relay)
    with server.accept()[0] as far:
        near.sendall(b"before")
        far.settimeout(PATIENCE_S)
        assert far.recv(100) == b"before"
        relay.silence()
        near.sendall(b"after")
        near.close()
        far.settimeout(QUIET_S)
        with pytest.raises(TimeoutError):
            far.recv(100)


def test_an_end_that_goes_is_heard_at_the_other_as_without_a_relay(server: socket.socket, relay: Relay) -> None:
    near = connect(relay)
    with server.accept()[0] as far:
        far.settimeout(PATIENCE_S)
        near.close()
        assert far.recv(10) == b""
    wait_until(lambda: not relay._pairs, "the relay to forget it", PATIENCE_S)


def test_a_simulator_that_is_not_there_is_like_a_door_that_is_shut() -> None:
    with listener() as gone:
        relay = Relay(f"tcp/127.0.0.1:{gone.getsockname()[1]}")
    with connect(relay) as near:
        assert near.recv(10) == b""
    relay.close()


def test_a_link_without_a_relay_or_without_a_connection_cannot_be_cut(relay: Relay) -> None:
    class Running:
        def poll(self) -> None:
            return None

    processes = Processes(lambda name: Running(), lambda name: None, lambda: "", (), {"a2": relay})  # type: ignore[arg-type,return-value]  # as much of a process as is looked at
    assert processes.do(Deed(1, "disconnect", "a1")) == "nothing stands in its link that could cut it"
    assert processes.do(Deed(2, "disconnect", "a2")) == "it has no link that could be cut"
    assert processes.do(Deed(3, "reconnect", "a2")) == ""


@pytest.mark.parametrize(
    ("chain", "possible"),
    [
        (["disconnect", "reconnect", "disconnect"], True),
        (["disconnect", "kill", "start"], True),
        (["disconnect", "start"], True),
        (["reconnect"], False),
        (["disconnect", "disconnect"], False),
        (["disconnect", "leave"], False),
        (["stop", "disconnect"], False),
        (["hang", "disconnect"], False),
    ],
)
def test_a_link_is_cut_of_who_has_one_and_heals_if_it_was_cut(chain: list[str], possible: bool) -> None:
    events = [{"at_s": 1.0 + k, "kind": kind, "agent": "a1"} for k, kind in enumerate(chain)]
    if possible:
        assert len(load_scenario("transport", {"events": events}).scenario.events) == len(chain)
    else:
        with pytest.raises(Exception, match=f"events.{len(chain) - 1}"):
            load_scenario("transport", {"events": events})
