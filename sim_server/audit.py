"""The audit of a run: did any key reach two agents? Asked of the transport's own tables, not of our good intentions.

Every second, off the tick's path, the simulator's session reads who has declared to hear, say or answer what. A session
goes by the agents whose sign of life or command key it declared; with access rules that is proven by the credential,
on an open system it is what the session claims. What happens between two looks is not seen, nor who watches the
liveliness of whom: the access rules must close that.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from sim_server.tally import Tallies
from sim_server.verdict import Verdict
from wire.keys import ArmKeys, Keys
from wire.link import Census, Link

EVERY_S = 1.0
"""Wall time between two looks; one costs less than a millisecond."""


@dataclass(slots=True)
class SessionSeen:
    """All that one session of another process declared, over all looks."""

    address: str
    agents: set[str] = field(default_factory=set)
    """Whose sign of life or command key it declared: who it is."""
    heard: dict[str, set[str]] = field(default_factory=dict)
    """What it asked to hear, with the keys of this run that this reaches."""
    answered: set[str] = field(default_factory=set)
    """What it offers to answer."""
    looks: int = 0

    @property
    def name(self) -> str:
        """For a sentence: the agents that it is, or that it is none and where it came from."""
        return " and ".join(sorted(self.agents)) or f"a session that is no agent (from {self.address})"


class Auditor:
    """Looks now and then, remembers, and judges at the end.

    Args:
        link: the simulator's link.
        keys: of the run.
        agents: every agent's own keys.
        names_proven: credentials and access rules stand behind the names: two sessions of one name are one agent's.
    """

    def __init__(self, link: Link, keys: Keys, agents: Mapping[str, ArmKeys], *, names_proven: bool = False) -> None:
        self._link, self._names_proven = link, names_proven
        self._agents = tuple(agents)
        self._owner = {
            key: name for name, its in agents.items() for key in (its.state, its.command, its.hello, its.alive)
        }
        self._names = {key: name for name, its in agents.items() for key in (its.command, its.alive)}
        self._keys = (*self._owner, keys.progress, keys.order)
        self.sessions: dict[str, SessionSeen] = {}
        self.looks = 0
        self._doubts: set[str] = set()

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Look now, then every so often on a thread of its own, and once more at the end."""
        over = threading.Event()

        def watch() -> None:
            while not over.wait(EVERY_S):
                self.look()

        thread = threading.Thread(target=watch, name="audit", daemon=True)
        self.look()
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            self.look()

    def look(self) -> None:
        """Take one census and add it to what was seen."""
        census = self._link.census(self._keys)
        if census is None:
            self._doubts.add("the transport did not tell who is connected")
            return
        self.looks += 1
        now = self._add(census)
        for name in self._agents:
            at_once = [session for session in now if self.sessions[session].agents == {name}]
            if len(at_once) > 1 and not self._names_proven:
                self._doubts.add(f"{len(at_once)} sessions went by the name {name} at the same time")

    def _add(self, census: Census) -> set[str]:
        """The sessions of this look."""
        now = set(census.addresses) | {declared.session for declared in census.declared}
        for session in now:
            seen = self.sessions.setdefault(session, SessionSeen(census.addresses.get(session, "nowhere known")))
            seen.looks += 1
        for declared in census.declared:
            seen = self.sessions[declared.session]
            if declared.kind in ("token", "publisher"):
                seen.agents |= {self._names[key] for key in declared.keys if key in self._names}
            elif declared.kind == "subscriber":
                seen.heard.setdefault(declared.expression, set()).update(declared.keys)
            else:
                seen.answered.add(declared.expression)
        return now

    def judge(self, were_in: set[str]) -> tuple[Verdict, list[str]]:
        """The verdict with its reasons; ``were_in`` are the agents that were let in."""
        violations = [text for seen in self.sessions.values() for text in self._violations(seen)]
        if violations:
            return "violated", sorted(violations)
        heard_own = {
            name
            for seen in self.sessions.values()
            for name in seen.agents
            for keys in seen.heard.values()
            if any(self._owner.get(key) == name for key in keys)
        }
        doubts = self._doubts | {
            f"{name} took part, but was never seen to hear its own key" for name in were_in - heard_own
        }
        if doubts or not self.looks:
            return "unknown", sorted(doubts) or ["nobody looked"]
        return "holds", [f"in {self.looks} looks, no key of an agent was heard by anybody else"]

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
        were_in = {name for name, process in processes.items() if process["lease"]}
        verdict, why = self.judge(were_in)
        return {
            "verdict": verdict,
            "why": why,
            "names_proven": self._names_proven,
            "looks": self.looks,
            "look_every_s": EVERY_S,
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
                    "looks": seen.looks,
                }
                for session, seen in self.sessions.items()
            },
        }
