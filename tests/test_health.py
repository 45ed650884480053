"""A container's health, told by the kernel's own table of sockets that really are there."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator

import pytest


def health(*arguments: str) -> int:
    return subprocess.run([sys.executable, "-m", "deploy.health", *arguments], check=False, timeout=30).returncode


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening


def test_a_port_is_healthy_as_long_as_somebody_listens(server: socket.socket) -> None:
    port = str(server.getsockname()[1])
    assert health("listening", port) == 0
    server.close()
    assert health("listening", port) == 1


def test_an_agent_is_healthy_as_long_as_it_is_connected(server: socket.socket) -> None:
    port = str(server.getsockname()[1])
    assert health("connected", port) == 1
    with socket.create_connection(server.getsockname()):
        assert health("connected", port) == 0
        assert health("listening", port) == 0
    accepted, _ = server.accept()
    accepted.close()
    assert health("connected", port) == 1


@pytest.mark.parametrize("arguments", [(), ("well",), ("listening", "seven"), ("listening", "7447", "7448")])
def test_what_nobody_can_ask_is_bad_input(arguments: tuple[str, ...]) -> None:
    assert health(*arguments) == 2
