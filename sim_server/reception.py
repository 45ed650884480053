"""Who is in: greetings, goodbyes and signs of life of all agents, and the one inbox that everything arrives in.

Transport threads only put things into the inbox; the server's own thread takes them out. No lock is needed.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from msgspec import Struct

from sim_server.snapshot import Snapshot, SnapshotError
from sim_server.tally import OPERATOR, STRANGERS, CountedPublisher, Tallies
from wire.codec import decode, decode_any, encode
from wire.errors import Reason, Refused
from wire.keys import ANY_HELLO, ArmKeys, Keys
from wire.lifecycle import GREETING_S, AgentLink, Invitation, Phase, check_hello
from wire.link import Link, Publisher, Question
from wire.messages import Goodbye, Hello, Leaving, Message, Refusal, Vector, Welcome

LEADER = "leader"
HELD_S = 0.8 * GREETING_S
"""A greeting that was held longer is not answered any more: its agent is about to greet again."""
STRANGERS_KEPT = 100
"""Kinds of strangers that are told apart; a flood of names must not fill the memory."""

Kind = Literal["answer", "alive", "gone", "question", "order"]


class Arrived(Struct, frozen=True, gc=False):
    """Something that came in: of which agent (or ``""``), and what."""

    kind: Kind
    name: str
    payload: bytes = b""
    question: Question | None = None


@dataclass(frozen=True, slots=True)
class Terms:
    """What an agent is told in its welcome."""

    clock: Literal["lock-step", "real-time"]
    period_ns: int
    points: dict[str, Vector]
    force_max_N: float
    carry_height_m: float = 0.0
    reach: Callable[[], Vector] = lambda: (0.0,) * 7
    """Where the strut is that it shall take; asked at its welcome."""


@dataclass(slots=True)
class Agent:
    """One agent: its life, how to reach it, and who it said it is."""

    link: AgentLink
    terms: Terms
    publisher: Publisher
    hello: Hello | None = None
    alive: bool = False
    """Whether its sign of life is there."""
    is_gone: bool = False
    """Whether its robot has been taken away: nobody can greet for it any more."""

    @property
    def is_in(self) -> bool:
        """Whether it gets states."""
        return self.link.phase in (Phase.READY, Phase.TICKING)


Report = Callable[..., None]
"""``report(kind, **details)``: where events go."""


class Reception:
    """All agents of one run.

    Args:
        link: the server's link.
        keys: of this run.
        invitations: whom to expect and on which terms, the leader under the name ``leader``.
        report: called for every event: joined, lost, left, refused.
        tallies: what crossed the edge before, if the run goes on.
    """

    def __init__(
        self,
        link: Link,
        keys: Keys,
        invitations: Iterable[tuple[Invitation, Terms]],
        report: Report,
        tallies: Tallies | None = None,
    ) -> None:
        self._keys, self._report = keys, report
        self.inbox: queue.SimpleQueue[Arrived] = queue.SimpleQueue()
        self.agents: dict[str, Agent] = {}
        self.tallies = tallies or Tallies()
        self.strangers: dict[str, int] = {}
        """Refusals of those who are nobody here, by run, name and reason."""
        self._link = link
        self._held: dict[str, tuple[Question, float] | None] = {}
        for invitation, terms in invitations:
            self.invite(invitation, terms)
        for expression in ANY_HELLO:
            link.answer_queries(expression, lambda question: self.inbox.put(Arrived("question", "", b"", question)))
        link.subscribe(keys.order, self._putter("order", "", keys.order))
        self._awaited = set(self.agents)
        link.declare_alive(keys.sim_alive)

    def invite(self, invitation: Invitation, terms: Terms, *, hold: bool = False) -> None:
        """Expect an agent; with ``hold`` its greeting is answered only after :meth:`let_in`."""
        name, link = invitation.name, self._link
        theirs = self.keys_of(name)
        publisher = CountedPublisher(link.publisher(theirs.state), self.tallies.of(name, theirs.state, "to"))
        self.agents[name] = Agent(AgentLink(invitation), terms, publisher)
        if hold:
            self._held[name] = None
        link.subscribe(theirs.command, self._putter("answer", name, theirs.command))
        link.watch_alive(theirs.alive, self._on_alive(name, theirs.alive))

    def let_in(self, name: str) -> None:
        """Answer the greeting of an agent that was invited for later; one that asked too long ago asks again."""
        waiting = self._held.pop(name, None)
        if waiting is not None and time.monotonic() - waiting[1] < HELD_S:
            self.answer(waiting[0])

    def dismiss(self, name: str, why: str) -> None:
        """Nobody is let in under this name any more: its robot has gone, or does not come. Whoever waits hears why."""
        self.agents[name].is_gone = True
        waiting = self._held.pop(name, None)
        if waiting is not None:
            waiting[0].reply(encode(Refusal(Reason.ARM, why)))

    def dismiss_those_held(self, why: str) -> None:
        """Nobody else is let in."""
        for name in list(self._held):
            self.dismiss(name, why)

    def keys_of(self, name: str) -> ArmKeys:
        """An agent's own keys."""
        return self._keys.leader if name == LEADER else self._keys.arm(name)

    def _putter(self, kind: Kind, name: str, key: str) -> Callable[[bytes], None]:
        inbox, tally = self.inbox, self.tallies.of(name or OPERATOR, key, "from")

        def take(payload: bytes) -> None:
            tally.messages += 1
            tally.size_bytes += len(payload)
            inbox.put(Arrived(kind, name, payload))

        return take

    def _on_alive(self, name: str, key: str) -> Callable[[bool], None]:
        inbox, tally = self.inbox, self.tallies.of(name, key, "from")

        def take(alive: bool) -> None:
            tally.messages += 1
            inbox.put(Arrived("alive" if alive else "gone", name))

        return take

    @property
    def followers(self) -> dict[str, Agent]:
        """All agents but the leader."""
        return {name: agent for name, agent in self.agents.items() if name != LEADER}

    def missing(self) -> list[str]:
        """Names of those who are awaited before the run begins, or goes on, and are not in."""
        return [name for name, agent in self.agents.items() if name in self._awaited and not agent.is_in]

    def state(self) -> Snapshot:
        """Every agent's life and last greeting, and the strangers."""
        lives = {
            name: {
                "link": agent.link.state(),
                "hello": encode(agent.hello) if agent.hello else None,
                "is_gone": agent.is_gone,
            }
            for name, agent in self.agents.items()
        }
        return {"agents": lives, "strangers": self.strangers}

    def restore(self, saved: Snapshot) -> None:
        """Await those who were in; before anything is taken out of the inbox."""
        if saved["agents"].keys() != self.agents.keys():
            raise SnapshotError(f"agents: got {', '.join(saved['agents'])}, expected {', '.join(self.agents)}")
        self._awaited.clear()
        for name, life in saved["agents"].items():
            agent = self.agents[name]
            agent.hello = decode(life["hello"], Hello) if life["hello"] else None
            agent.is_gone = bool(life["is_gone"])
            if agent.link.resume(life["link"]):
                self._awaited.add(name)
        self.strangers = {str(stranger): int(times) for stranger, times in saved["strangers"].items()}

    def match(self) -> list[str]:
        """Let those in whose links have come up in both directions; return their names."""
        ready = []
        for name, agent in self.agents.items():
            if agent.link.phase is Phase.HELLO and agent.publisher.matched():
                agent.link.matched()
                ready.append(name)
                hello = agent.hello
                self._report("joined", agent=name, lease=agent.link.lease, pid=hello.pid if hello else 0)
        return ready

    def answer(self, question: Question) -> str | None:
        """Reply to a greeting, a notice or a goodbye; the name of an agent that left, or None."""
        name = self._named(question.key)
        agent = self.agents.get(name)
        ours = agent is not None and question.key == self.keys_of(name).hello
        whose = (name, question.key) if ours else (STRANGERS, "*/hello")  # one row: a flood of names must not fill it
        self.tallies.of(*whose, "from").add(question.payload)

        def reply(message: Message) -> None:
            payload = encode(message)
            self.tallies.of(*whose, "to").add(payload)
            question.reply(payload)

        try:
            message = decode_any(question.payload)
            run = question.key.split("/")[1]
            if run != self._keys.run:
                raise Refused(Reason.RUN, "run", run, self._keys.run, "Give the simulator's run name with --run")
            if agent is None:
                raise Refused(Reason.ARM, "name", name, "an arm of this run")
            if agent.is_gone:
                raise Refused(Reason.ARM, "robot", name, "one that is there", "It has been taken away, or never came")
            if isinstance(message, Leaving):
                agent.link.begin_to_leave(message)
                reply(message)
                self._report("leaving", agent=name)
                return None
            if isinstance(message, Goodbye):
                agent.link.goodbye(message)
                reply(message)
                self._report("left", agent=name)
                return name
            if not isinstance(message, Hello):
                raise Refused(Reason.TYPE, "type", type(message).__name__, "hello, leaving or goodbye")
            if name in self._held:
                check_hello(message, agent.link.invitation)
                self._held[name] = question, time.monotonic()
                return None
            lease = agent.link.greet(message)
        except Refused as refusal:
            run = question.key.split("/")[1]
            self.refuse(name if run == self._keys.run else f"{run}/{name}", refusal)
            reply(Refusal(refusal.reason, str(refusal)))
            return None
        agent.hello = message
        terms = agent.terms
        reply(
            Welcome(
                lease,
                terms.clock,
                terms.period_ns,
                terms.points,
                terms.force_max_N,
                terms.carry_height_m,
                terms.reach(),
            )
        )
        return None

    @staticmethod
    def _named(key: str) -> str:
        """The agent whose ``hello`` key this is; no arm is the leader, even if it calls itself so."""
        parts = key.split("/")
        if len(parts) != 5:
            return LEADER
        return parts[3] if parts[3] != LEADER else ""

    def refuse(self, name: str, refusal: Refused) -> None:
        """Count a refusal; report the first of each kind and agent."""
        agent = self.agents.get(name)
        if agent is None:
            stranger = f"{name} {refusal.reason}"
            if stranger not in self.strangers and len(self.strangers) >= STRANGERS_KEPT:
                stranger = "others"
            self.strangers[stranger] = self.strangers.get(stranger, 0) + 1
            first = self.strangers[stranger] == 1
        else:
            agent.link.count_refusal(refusal.reason)
            first = agent.link.refused[refusal.reason] == 1
        if first:
            self._report("refused", agent=name, reason=refusal.reason, text=str(refusal))

    def refused(self) -> int:
        """Number of messages refused so far."""
        return sum(self.strangers.values()) + sum(sum(agent.link.refused.values()) for agent in self.agents.values())
