"""A relay that stands in one agent's connection to the simulator, where a scenario will cut that: bytes in, bytes out.

The agent is told the relay's address in place of the simulator's, and nothing else is different for it. What it says
goes through unread. A link that is cut is closed at both ends, as when a machine between the two goes down, and whoever
tries it meanwhile is turned away.
"""

from __future__ import annotations

import socket
import threading
from contextlib import suppress

from wire.endpoints import parse_endpoint

CONNECT_S = 5.0
CHUNK = 65536

_Pair = tuple[socket.socket, socket.socket]


class Relay:
    """One agent's way to the simulator.

    Args:
        target: the simulator's address, ``tcp/...``; somebody need not listen there yet, or any more.
    """

    def __init__(self, target: str) -> None:
        self._target = parse_endpoint(target)
        self._lock = threading.Lock()
        self._pairs: set[_Pair] = set()
        self._is_cut = False
        self._carries = threading.Event()
        self._carries.set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, name="relay", daemon=True).start()

    def cut(self) -> int:
        """End all connections and let none in; how many there were."""
        with self._lock:
            self._is_cut = True
            for pair in self._pairs:
                _shut(pair)
            return len(self._pairs)

    def restore(self) -> None:
        """Let connections in again."""
        with self._lock:
            self._is_cut = False

    def silence(self) -> None:
        """Carry nothing any more, as a cable that is pulled: both ends stay open and hear nothing."""
        self._carries.clear()

    def close(self) -> None:
        """End it."""
        self.cut()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):  # it has been closed
            while True:
                inner, _ = self._listener.accept()
                self._let_in(inner)

    def _let_in(self, inner: socket.socket) -> None:
        with self._lock:
            is_cut = self._is_cut
        try:
            if is_cut:  # the simulator is not to hear of it
                raise ConnectionRefusedError
            outer = socket.create_connection((self._target.host, self._target.port), CONNECT_S)
        except OSError:
            inner.close()
            return
        outer.settimeout(None)
        pair = inner, outer
        with self._lock:
            if self._is_cut:
                inner.close()
                outer.close()
                return
            self._pairs.add(pair)
        for each in pair:
            each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        back = threading.Thread(target=self._pump, args=(outer, inner, pair), name="relay-back", daemon=True)
        threading.Thread(target=self._forth, args=(pair, back), name="relay-forth", daemon=True).start()

    def _forth(self, pair: _Pair, back: threading.Thread) -> None:
        """From the agent on; when both ways are over the connection is."""
        back.start()
        self._pump(*pair, pair)
        back.join()
        with self._lock:
            self._pairs.discard(pair)
        for each in pair:
            each.close()

    def _pump(self, source: socket.socket, sink: socket.socket, pair: _Pair) -> None:
        with suppress(OSError):
            while data := source.recv(CHUNK):
                if self._carries.is_set():
                    sink.sendall(data)
        if self._carries.is_set():
            _shut(pair)  # one end is gone: the other hears of it


def _shut(pair: _Pair) -> None:
    for each in pair:
        with suppress(OSError):
            each.shutdown(socket.SHUT_RDWR)
