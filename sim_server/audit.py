"""The audit of a run: did any key reach two agents? Two witnesses tell, not our own good intentions.

The kernel counts, all through the run, what each connection carried (sim_server/connections.py). And once, when the
rest of the run is on the disk, the simulator's session reads who has declared to hear, say or answer what. Not while it
goes on: Zenoh answers that query with a lock held that its answer wants again, and if somebody comes, goes or declares
between the two, the session hangs for ever. A session goes by the agents whose sign of life or command key it
declared; with access rules that is proven by the credential, on an open system it is what the session claims.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from sim_server.byte_account import Account, account
from sim_server.connections import EVERY_S, Connections
from sim_server.tally import Tallies
from sim_server.verdict import Verdict
from wire.keys import ArmKeys, Keys
from wire.link import Census, Link

LOOK_S = 2.0
"""Wall time that the final look gets; it takes a few milliseconds."""


@dataclass(slots=True)
class SessionSeen:
    """All that one session of another process has declared."""

    address: str
    agents: set[str] = field(default_factory=set)
    """Whose sign of life or command key it declared: who it is."""
    heard: dict[str, set[str]] = field(default_factory=dict)
    """What it asked to hear, with the keys of this run that this reaches."""
    answered: set[str] = field(default_factory=set)
    """What it offers to answer."""

    @property
    def name(self) -> str:
        """For a sentence: the agents that it is, or that it is none and where it came from."""
        return " and ".join(sorted(self.agents)) or f"a session that is no agent (from {self.address})"


class Auditor:
    """Looks once, and judges.

    Args:
        link: the simulator's link.
        keys: of the run.
        agents: every agent's own keys.
        connections: what the kernel counted.
        names_proven: credentials and access rules stand behind the names: two sessions of one name are one agent's.
    """

    def __init__(
        self,
        link: Link,
        keys: Keys,
        agents: Mapping[str, ArmKeys],
        connections: Connections,
        *,
        names_proven: bool = False,
    ) -> None:
        self._link, self._names_proven = link, names_proven
        self._agents: list[str] = []
        self._owner: dict[str, str] = {}
        self._names: dict[str, str] = {}
        self._others = (keys.progress, keys.rows, keys.events, keys.order)
        for name, its in agents.items():
            self.expect(name, its)
        self.connections = connections
        self.sessions: dict[str, SessionSeen] = {}
        self.has_looked = self.hangs = False
        self._doubts: set[str] = set()
        self._leases_before: Mapping[str, int] = {}

    def go_on(self, time_s: float, leases: Mapping[str, int]) -> None:
        """The run goes on at this simulated time in another simulator: its end can be judged, but not the whole."""
        self._leases_before = dict(leases)
        self._doubts.add(
            f"the simulator was started again and went on from {time_s:g} s: what the connections to the one before "
            "carried is not known"
        )

    def expect(self, name: str, its: ArmKeys) -> None:
        """One more agent, with its keys."""
        self._agents.append(name)
        self._owner |= dict.fromkeys((its.state, its.command, its.hello, its.alive), name)
        self._names |= dict.fromkeys((its.command, its.alive), name)

    def look(self, timeout_s: float = LOOK_S) -> None:
        """The final look. If it does not come back, the link ``hangs``, and nothing may be asked of it any more."""
        came: list[Census | None] = []

        def ask() -> None:
            came.append(self._link.census((*self._owner, *self._others)))

        thread = threading.Thread(target=ask, name="final look", daemon=True)
        thread.start()
        thread.join(timeout_s)
        self.hangs = thread.is_alive()
        if self.hangs:
            self._doubts.add(f"the final look did not come back within {timeout_s:g} s")
        elif not came or came[0] is None:
            self._doubts.add("the transport did not tell who is connected")
        else:
            self.has_looked = True
            self._add(came[0])

    def _add(self, census: Census) -> None:
        for session in sorted({*census.addresses, *(declared.session for declared in census.declared)}):
            self.sessions[session] = SessionSeen(census.addresses.get(session, "nowhere known"))
        for declared in census.declared:
            seen = self.sessions[declared.session]
            if declared.kind in ("token", "publisher"):
                seen.agents |= {self._names[key] for key in declared.keys if key in self._names}
            elif declared.kind == "subscriber":
                seen.heard.setdefault(declared.expression, set()).update(declared.keys)
            else:
                seen.answered.add(declared.expression)
        for name in self._agents:
            at_once = sum(seen.agents == {name} for seen in self.sessions.values())
            if at_once > 1 and not self._names_proven:
                self._doubts.add(f"{at_once} sessions went by the name {name} at the same time")

    def judge(self, lives: Mapping[str, int]) -> tuple[Verdict, list[str], Account]:
        """The verdict with its reasons; ``lives`` tells how often each agent was let in."""
        names = {seen.address.partition("/")[2]: seen.agents for seen in self.sessions.values()}
        counted = account(self.connections, names, lives)
        violations = [text for seen in self.sessions.values() for text in self._violations(seen)] + counted.violations
        if violations:
            return "violated", sorted(violations), counted
        heard_own = {
            name
            for seen in self.sessions.values()
            for name in seen.agents
            for keys in seen.heard.values()
            if any(self._owner.get(key) == name for key in keys)
        }
        were_in = {name for name, times in lives.items() if times}
        doubts = self._doubts | set(counted.doubts)
        doubts |= {
            f"{name} took part, but was never seen to hear its own key" for name in were_in - heard_own - counted.agents
        }
        if self.connections.problem:
            doubts.add(self.connections.problem)
        if doubts or not self.has_looked:
            return "unknown", sorted(doubts) or ["nobody looked"], counted
        found = [
            "in the final look, no key of an agent was heard by anybody else",
            f"in the whole run, {len(counted.accounted)} connections carried no more than the messages meant for them",
        ]
        if counted.silent:
            found.append(
                f"{counted.silent} more connections carried no more than an opening and signs of life, and are nobody's"
            )
        return "holds", found + counted.notes, counted

    def _violations(self, seen: SessionSeen) -> Iterator[str]:
        if len(seen.agents) > 1:
            yield f"one session stands for {seen.name}: what one hears, the other hears"
        for expression, keys in seen.heard.items():
            asked = f" (asked for {expression})" if keys != {expression} else ""
            for key in sorted(keys):
                owner = self._owner.get(key)
                if owner is not None and seen.agents != {owner}:
                    yield f"{seen.name} listened to {key}{asked}, which is {owner}'s"
                elif owner is None and seen.agents:
                    yield f"{seen.name} listened to {key}{asked}, which is for no agent"
            if not keys and seen.agents:
                yield f"{seen.name} listened to {expression}, where only another agent could speak"
        for expression in sorted(seen.answered):
            yield f"{seen.name} offered to answer {expression} in the simulator's place"

    def describe(self, tallies: Tallies, processes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """The content of audit.json; ``processes`` tells each agent's pid, host and lease."""
        lives = {name: int(process["lease"]) - self._leases_before.get(name, 0) for name, process in processes.items()}
        verdict, why, counted = self.judge(lives)
        overhead = self.connections.overhead
        return {
            "verdict": verdict,
            "why": why,
            "names_proven": self._names_proven,
            "final_look_came_back": not self.hangs,
            "connections_counted_every_s": EVERY_S,
            "processes": dict(processes),
            "counts": [
                {
                    "agent": tally.agent,
                    "key": tally.key,
                    "direction": tally.direction,
                    "messages": tally.messages,
                    "bytes": tally.size_bytes,
                }
                for tally in tallies.rows.values()
            ],
            "sessions": {
                session: {
                    "address": seen.address,
                    "agents": sorted(seen.agents),
                    "heard": {expression: sorted(keys) for expression, keys in sorted(seen.heard.items())},
                    "answered": sorted(seen.answered),
                }
                for session, seen in self.sessions.items()
            },
            "most_overhead_bytes": {
                "opening": overhead.opening,
                "per_message": overhead.per_message,
                "per_s": overhead.per_s,
            },
            "connections": [
                {
                    "agent": each.who,
                    "known": each.how,
                    "from": each.connection.carried.peer,
                    "bytes_to_it": each.connection.carried.sent,
                    "explained_at_most": each.explained,
                    "bytes_from_it": each.connection.carried.received,
                    "not_taken_in": each.refused,
                }
                for each in sorted(counted.accounted, key=lambda each: each.who)
            ],
            "connections_without_a_message": counted.silent,
        }
