"""Whose each connection was, and whether its agent's own messages explain what it carried.

The final look tells whose a connection is that is still there. One that has gone is an agent's if that agent has a life
that no other connection accounts for, and if it brought all that the agent said and got no more than was meant for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sim_server.connections import Connection, Connections
from sim_server.tally import OBSERVERS


@dataclass(frozen=True, slots=True)
class Accounted:
    """One connection with whom it is counted as."""

    connection: Connection
    who: str
    """An agent, observers, or "" if nobody knows."""
    how: str
    """How that is known."""
    explained: int
    """Most bytes to it that are explained."""
    refused: int
    """Bytes that it brought beyond what was taken in: what the edge refused. They reached nobody."""


@dataclass(slots=True)
class Account:
    """All connections, and what is wrong with them."""

    accounted: list[Accounted] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    silent: int = 0
    """Connections that got less than one message: refused logins, and others who heard nothing."""

    @property
    def agents(self) -> set[str]:
        """Whose connections are known."""
        return {each.who for each in self.accounted}


def account(connections: Connections, names: Mapping[str, set[str]], lives: Mapping[str, int]) -> Account:
    """Hold every connection against the tallies.

    Args:
        names: by address, the agents of the session that came from there; an empty set for one that is no agent.
        lives: of every agent, how often it was let in.
    """
    result, overhead = Account(), connections.overhead
    left = dict(lives)
    unnamed = []
    for each in connections.found.values():
        agents = names.get(each.carried.peer) if each.is_there else None
        if agents is None or len(agents) > 1:  # more than one: a violation that is told elsewhere
            unnamed.append(each)
            continue
        who = next(iter(agents), OBSERVERS)
        left[who] = left.get(who, 0) - 1
        how = "final look"
        _hold(result, each, who, how, connections)
    for each in sorted(unnamed, key=lambda each: -each.carried.sent):
        fits = [
            name
            for name, lives_left in left.items()
            if lives_left > 0
            and each.brought(name) <= each.carried.received
            and each.later.taken.get(name)
            and each.carried.sent <= each.explained(name, overhead)
        ]
        most = max((each.explained(name, overhead) for name in lives), default=0)
        if each.carried.sent <= each.besides(overhead) and not (fits and each.carried.received > overhead.opening):
            result.silent += 1
        elif fits:
            who = max(fits, key=lambda name: each.brought(name))
            left[who] -= 1
            _hold(result, each, who, "gone; its bytes", connections)
        elif each.carried.sent > max(most, each.explained(OBSERVERS, overhead)):
            result.violations.append(
                f"a connection from {each.carried.peer} carried {each.carried.sent:,} bytes, more than the messages to "
                f"any one agent explain ({most:,})"
            )
        else:
            result.doubts.append(
                f"whose connection from {each.carried.peer} was is not known; it carried {each.carried.sent:,} bytes"
            )
    return result


def _hold(result: Account, each: Connection, who: str, how: str, connections: Connections) -> None:
    carried, overhead = each.carried, connections.overhead
    explained = each.explained(who, overhead)
    refused = max(0, carried.received - each.explained_from(who, overhead))
    result.accounted.append(Accounted(each, who, how, explained, refused))
    if carried.sent > explained:
        whose = "a session that is no agent" if who == OBSERVERS else who
        result.violations.append(
            f"the connection of {whose} (from {carried.peer}) carried {carried.sent:,} bytes to it, and the messages "
            f"meant for it explain at most {explained:,}"
        )
    if refused and who != OBSERVERS:
        result.notes.append(f"{who} sent {refused:,} bytes that the simulator did not take in")
