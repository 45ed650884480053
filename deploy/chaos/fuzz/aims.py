"""Where messages are taken in, what is known there, and which message would be a whole one.

A whole message is what its receiver is there for: the answer of that arm to this very tick, with its lease. It is
believed, as it must be, so it is no fuzz. All others must change nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from deploy.chaos.fuzz.spoiling import Draws, changed
from wire.codec import decode_any
from wire.errors import Refused
from wire.messages import Command, Done, End, Goodbye, LeaderForce, LeaderView, Leaving, Message, Order, State

Sort = Literal["answer", "greeting", "order", "told"]
"""What is taken in there: answers to a tick, what agents greet with, the operator's orders, what agents are told."""

JOINTS = 7
OTHER_COUNTS = (0, 1, 2**31, 2**63 - 1)


@dataclass(slots=True)
class Moment:
    """What everybody knows just now."""

    tick: int = -1
    """Whose states are going out."""
    answered: set[str] = field(default_factory=set)
    """Who has answered it, and those who were not asked."""
    got: dict[str, int] = field(default_factory=lambda: defaultdict(lambda: -1))
    """The newest tick of which an agent was told."""
    leases: dict[str, int] = field(default_factory=lambda: defaultdict(int))


@dataclass(slots=True)
class Aim:
    """One key on which somebody takes messages in."""

    sort: Sort
    name: str
    """The agent that it is about; ``""`` for the operator, and for those who are nobody in this run."""
    key: str
    real: list[bytes] = field(default_factory=list)
    """Real messages of this key: the newest answer or state, all greetings, all orders."""

    @property
    def receiver(self) -> str:
        """Who takes in what is sent there, and counts what it refuses."""
        return f"agent {self.name}" if self.sort == "told" else f"simulator, of {self.name or 'others'}"

    def is_whole(self, payload: bytes, now: Moment) -> bool:
        """Whether its receiver shall believe it."""
        try:
            message = decode_any(payload)
        except Refused:
            return False
        if self.sort == "order":
            return isinstance(message, Order | Done)
        if self.sort == "greeting":  # all who may greet are in, and are refused as taken
            if not isinstance(message, Goodbye | Leaving):
                return False
            return (message.name, message.lease) == (self.name, now.leases[self.name])
        if self.sort == "answer":
            return self._answers(message, now)
        if isinstance(message, State):
            fits = message.arm == self.name and _have_length((message.q, message.qd, message.tau))
            return fits and message.tick > now.got[self.name]
        is_view = isinstance(message, LeaderView) and self.name == "leader" and message.tick > now.got[self.name]
        return is_view or isinstance(message, End)

    def _answers(self, message: Message, now: Moment) -> bool:
        if isinstance(message, Command):
            fits = message.arm == self.name and _have_length((message.torque, message.stiffness))
        else:
            fits = isinstance(message, LeaderForce) and self.name == "leader"
        if not fits or not isinstance(message, Command | LeaderForce):
            return False
        in_time = message.tick == now.tick and self.name not in now.answered
        return in_time and message.lease == now.leases[self.name]

    def misplaced(self, draws: Draws, now: Moment, others: Mapping[str, list[bytes]]) -> tuple[str, bytes] | None:
        """A message without a flaw in itself that does not belong here, or not now, and what is wrong with it; None if
        there is none of the kind that was drawn.

        Args:
            others: real messages of other keys.
        """
        way = draws.choice(("another tick", "another lease", "the same again", "from another key"))
        if way == "from another key":
            return way, draws.choice(others[draws.choice([key for key in others if others[key] and key != self.key])])
        if way == "the same again" and self.sort != "order":
            return way, self.real[0]
        if way == "another lease" and self.sort in ("answer", "greeting"):
            lease = now.leases[self.name]
            other = draws.choice([count for count in (lease - 1, lease + 1, *OTHER_COUNTS) if count != lease])
            return way, changed(self.real[-1], lease=max(other, 0), tick=now.tick)
        if way == "another tick" and self.sort == "answer":
            tick = draws.choice((now.tick - 1, draws.randint(0, now.tick - 1), now.tick + 1, *OTHER_COUNTS[2:]))
            return way, changed(self.real[0], tick=tick)
        if way == "another tick" and self.sort == "told":
            return way, changed(self.real[0], tick=draws.randint(0, now.got[self.name]))
        return None


def _have_length(vectors: tuple[tuple[float, ...], ...]) -> bool:
    return all(len(vector) == JOINTS for vector in vectors)
