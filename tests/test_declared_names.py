"""What the simulator's edge sends to a session before any message: no name of anything that is not its own.

Read from the bytes on the line (tcp with passwords is plain text after the opening), for every mode in which a hostile
agent could open its session. Zenoh's access rules do not see declarations of names; the region does.
"""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator

import pytest
import zenoh
from processes import free_port, wait_until

from wire.credentials import for_one_run
from wire.keys import ANY_HELLO, Keys
from wire.zenoh_config import client_config
from wire.zenoh_link import ZenohLink, open_client, open_server

pytestmark = pytest.mark.system

KEYS = Keys("carry")
VICTIMS = ("victim-two", "victim-three")
"""Names that no random id contains by chance."""
ARMS = ("a1", *VICTIMS)


class Tap:
    """A relay to ``port`` that keeps every byte on its way back."""

    def __init__(self, port: int) -> None:
        self._to = port
        self.heard = bytearray()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        try:
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(("127.0.0.1", self._to))
                threading.Thread(target=self._pump, args=(near, far, False), daemon=True).start()
                threading.Thread(target=self._pump, args=(far, near, True), daemon=True).start()
        except OSError:
            return

    def _pump(self, source: socket.socket, sink: socket.socket, keep: bool) -> None:
        try:
            while data := source.recv(65536):
                if keep:
                    self.heard += data
                sink.sendall(data)
        except OSError:
            return

    def close(self) -> None:
        self._listener.close()


@pytest.fixture
def tap() -> Iterator[tuple[Tap, dict[str, object], list[ZenohLink]]]:
    """A protected simulator with three arms, one victim being in, and a tap on the way to it for a1's credential."""
    guests, port = for_one_run([*ARMS, "leader", "operator"]), free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    with open_server(endpoint, guests, "carry") as server, open_client(endpoint, guests.of(VICTIMS[0])) as other:
        for arm in ARMS:
            server.subscribe(KEYS.arm(arm).command, lambda _: None)
            server.publisher(KEYS.arm(arm).state)
        for expression in ANY_HELLO:
            server.answer_queries(expression, lambda _: None)
        server.subscribe(KEYS.order, lambda _: None)
        server.declare_alive(KEYS.sim_alive)
        other.subscribe(KEYS.arm(VICTIMS[0]).state, lambda _: None)
        other.declare_alive(KEYS.arm(VICTIMS[0]).alive)
        wire_tap = Tap(port)
        try:
            yield wire_tap, client_config(wire_tap.endpoint, guests.of("a1")), [server, other]
        finally:
            wire_tap.close()


@pytest.mark.parametrize("mode", ["client", "peer"])
def test_no_name_of_anybody_else_is_on_the_line(mode: str, tap: tuple[Tap, dict[str, object], list[ZenohLink]]) -> None:
    wire_tap, config, (server, _) = tap
    own, states = KEYS.arm("a1"), server.publisher(KEYS.arm("a1").state)
    with zenoh.open(zenoh.Config.from_json5(json.dumps({**config, "mode": mode}))) as session:
        got: list[bytes] = []

        def note(sample: zenoh.Sample) -> None:
            got.append(sample.payload.to_bytes())

        session.declare_subscriber(own.state, zenoh.handlers.Callback(note, indirect=False))
        session.declare_subscriber("**", zenoh.handlers.Callback(note, indirect=False))
        session.liveliness().declare_subscriber("**", zenoh.handlers.Callback(note, indirect=False))

        def own_state_comes() -> bool:
            states.put(b"to a1")
            return bool(got)

        # What is allowed comes through, and the tap sees it: whatever was declared before it has passed as well.
        wait_until(own_state_comes, "a1's own state")
        assert b"to a1" in wire_tap.heard
    for foreign in (*VICTIMS, "operator", "leader", "truth"):
        assert foreign.encode() not in wire_tap.heard, bytes(wire_tap.heard)


def test_a_router_is_turned_away(tap: tuple[Tap, dict[str, object], list[ZenohLink]]) -> None:
    wire_tap, config, _ = tap
    started = time.monotonic()
    with pytest.raises(zenoh.ZError):
        zenoh.open(zenoh.Config.from_json5(json.dumps({**config, "mode": "router"})))
    assert time.monotonic() - started < 10
    assert wire_tap.heard, "nothing came back, so nothing was looked at"
    assert b"palanquin" not in wire_tap.heard
