"""What the kernel counted: true to what was sent, explained where it is the agent's own, else a violation."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence

import pytest

from sim_server import connections
from sim_server.byte_account import Account, account
from sim_server.connections import Beginnings, Connections, Flow, Overhead
from sim_server.tally import OBSERVERS, Tallies
from sim_server.wiretap import Carried, Wiretap
from wire.endpoints import parse_endpoint

OVERHEAD = Overhead(opening=100, per_message=10, per_s=0)
STATE, COMMAND = 300, 200


# The kernel


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_the_kernel_counts_every_byte_of_both_directions_on_the_listening_port_only(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        server, other = (socket.create_server((host, 0), family=family) for _ in range(2))
    except OSError:
        if ":" not in host:
            raise
        pytest.skip(f"this machine has no {host}")
    port = server.getsockname()[1]
    tap = Wiretap(parse_endpoint(f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}"))
    elsewhere = socket.create_connection((host, other.getsockname()[1]))
    with server, other, socket.create_connection((host, port)) as client, elsewhere:
        accepted, _ = server.accept()
        with accepted:
            accepted.sendall(bytes(5000))
            client.sendall(bytes(70))
            for end, size in ((client, 5000), (accepted, 70)):
                while size:
                    size -= len(end.recv(size))
            (carried,) = tap.connections()
            assert (carried.sent, carried.received) == (5000, 70)
            own = client.getsockname()
            assert carried.peer == (f"[{host}]:{own[1]}" if ":" in host else f"{host}:{own[1]}")
    with server:
        assert tap.connections() == []


# The account


class Kernel:
    """Tells what a test says; each connection by its number and address."""

    def __init__(self) -> None:
        self.tallies = Tallies()
        self.now: dict[int, list[int]] = {}
        self.connections_of_the_run = Connections(self, self.tallies, OVERHEAD)

    def connections(self) -> Sequence[Carried]:
        return [Carried(number, f"here:{number}", *both) for number, both in self.now.items()]

    def opened(self, *numbers: int) -> None:
        for number in numbers:
            self.now[number] = [60, 60]

    def ticks(self, count: int, **agents: int) -> None:
        """So many states go to each agent over its connection, and its answers come back."""
        for name, number in agents.items():
            self.meant(count, name)
            if number in self.now:
                self.now[number][0] += count * (STATE + OVERHEAD.per_message)
                self.now[number][1] += count * (COMMAND + OVERHEAD.per_message)

    def meant(self, count: int, name: str) -> None:
        for key, direction, size in (("state", "to", STATE), ("command", "from", COMMAND)):
            row = self.tallies.of(name, key, direction)  # type: ignore[arg-type]
            row.messages += count
            row.size_bytes += count * size

    def heard_more(self, number: int, count: int) -> None:
        self.now[number][0] += count * (STATE + OVERHEAD.per_message)

    def count(self) -> None:
        self.connections_of_the_run.count()

    def account(self, names: dict[int, set[str]], **lives: int) -> Account:
        self.count()
        by_address = {f"here:{number}": agents for number, agents in names.items()}
        return account(self.connections_of_the_run, by_address, lives)


def test_what_each_agent_was_meant_to_hear_explains_its_connection() -> None:
    kernel = Kernel()
    kernel.opened(1, 2, 9)
    kernel.ticks(1000, a1=1, a2=2)
    result = kernel.account({1: {"a1"}, 2: {"a2"}, 9: set()}, a1=1, a2=1)
    assert (result.violations, result.doubts) == ([], [])
    assert [each.who for each in result.accounted] == ["a1", "a2", OBSERVERS]


@pytest.mark.parametrize("count", [1000, 100, 5])
def test_an_agent_that_heard_states_of_another_has_more_than_its_own_explain(count: int) -> None:
    kernel = Kernel()
    kernel.opened(1, 2)
    kernel.ticks(500, a1=1, a2=2)
    kernel.heard_more(2, count)
    kernel.count()
    kernel.ticks(500, a1=1, a2=2)
    (said,) = kernel.account({1: {"a1"}, 2: {"a2"}}, a1=1, a2=1).violations
    carried, explained = 60 + (1000 + count) * 310, 1000 * 310 + 100
    assert said.startswith("the connection of a2 (from here:2)")
    assert f"{carried:,}" in said
    assert f"{explained:,}" in said


def test_who_watches_the_truth_and_carries_more_than_the_truth_is_a_violation() -> None:
    kernel = Kernel()
    kernel.opened(1, 9)
    kernel.ticks(100, a1=1)
    kernel.heard_more(9, 10)
    (said,) = kernel.account({1: {"a1"}, 9: set()}, a1=1).violations
    assert said.startswith("the connection of a session that is no agent")


def test_a_killed_agents_connection_is_known_by_its_bytes() -> None:
    kernel = Kernel()
    kernel.opened(1, 2)
    kernel.ticks(500, a1=1, a2=2)
    kernel.count()
    del kernel.now[2]
    kernel.ticks(500, a1=1)
    result = kernel.account({1: {"a1"}}, a1=1, a2=1)
    assert (result.violations, result.doubts) == ([], [])
    assert result.agents == {"a1", "a2"}


def test_an_agent_that_began_to_speak_or_spoke_again_is_told_once_when_it_has_said_enough() -> None:
    beginnings = Beginnings(1000)
    said = [0, 600, 1200, 1800, 1800, 2700, 2900]
    told = [beginnings.any_in({"a1": Flow(1, size), "a2": Flow(1, 50)}) for size in said]
    assert told == [False, False, True, False, False, False, True]


def test_one_whose_first_words_were_many_is_told_at_once() -> None:
    assert Beginnings(1000).any_in({"a1": Flow(20, 5000)})


def test_an_agent_that_dies_soon_after_its_first_words_was_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the time between two regular counts: the connection was there when it had said enough."""
    monkeypatch.setattr(connections, "EVERY_S", 1000.0)
    kernel = Kernel()
    kernel.opened(1, 2)
    with kernel.connections_of_the_run.watching():
        kernel.ticks(20, a1=1, a2=2)
        deadline = time.monotonic() + 10.0
        while not all(each.later.taken for each in list(kernel.connections_of_the_run.found.values())):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        del kernel.now[2]
        kernel.ticks(500, a1=1)
    result = kernel.account({1: {"a1"}}, a1=1, a2=1)
    assert (result.violations, result.doubts) == ([], [])
    assert result.agents == {"a1", "a2"}


def test_an_agent_that_came_back_has_two_connections_and_each_is_held_against_its_own_time() -> None:
    kernel = Kernel()
    kernel.opened(1, 2)
    kernel.ticks(500, a1=1, a2=2)
    kernel.count()
    del kernel.now[2]
    kernel.count()
    kernel.opened(3)
    kernel.ticks(500, a1=1, a2=3)
    result = kernel.account({1: {"a1"}, 3: {"a2"}}, a1=1, a2=2)
    assert (result.violations, result.doubts) == ([], [])
    kernel.heard_more(3, 100)  # far below what a2's two lives together explain
    assert kernel.account({1: {"a1"}, 3: {"a2"}}, a1=1, a2=2).violations


def account_after_one_heard_and_went(count: int) -> Account:
    """Two agents that stay, and a third connection that heard so many states."""
    kernel = Kernel()
    kernel.opened(1, 2, 3)
    kernel.ticks(500, a1=1, a2=2)
    kernel.heard_more(3, count)
    kernel.count()
    del kernel.now[3]
    return kernel.account({1: {"a1"}, 2: {"a2"}}, a1=1, a2=1)


def test_one_that_heard_and_went_is_not_taken_for_an_agent_that_is_there() -> None:
    (doubt,) = account_after_one_heard_and_went(400).doubts
    assert doubt == "whose connection from here:3 was is not known; it carried 124,060 bytes"


def test_one_that_heard_two_agents_and_went_is_a_violation_whoever_it_was() -> None:
    (said,) = account_after_one_heard_and_went(1000).violations
    assert "more than the messages to any one agent explain" in said


def test_connections_that_carried_less_than_a_message_are_nobodys() -> None:
    kernel = Kernel()
    kernel.opened(1, 3, 4)
    kernel.ticks(500, a1=1)
    kernel.count()
    del kernel.now[3], kernel.now[4]
    result = kernel.account({1: {"a1"}}, a1=1)
    assert (result.violations, result.doubts, result.silent) == ([], [], 2)


def test_what_an_agent_sent_and_the_edge_refused_is_told_and_is_no_violation() -> None:
    kernel = Kernel()
    kernel.opened(1)
    kernel.ticks(100, a1=1)
    kernel.now[1][1] += 50_000
    result = kernel.account({1: {"a1"}}, a1=1)
    assert result.violations == []
    (note,) = result.notes
    assert note.startswith("a1 sent 49,9")


def test_a_kernel_that_does_not_tell_is_a_problem_that_is_told_once_and_stays() -> None:
    class Mute:
        def connections(self) -> Sequence[Carried]:
            raise OSError("no such thing here")

    connections = Connections(Mute(), Tallies(), OVERHEAD)
    connections.count()
    connections.count()
    assert connections.problem == "what each connection carried could not be counted (no such thing here)"
