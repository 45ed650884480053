"""The life of an agent as the simulator sees it: one transition table, no I/O, no clock.

    absent --greeted--> hello --matched--> ready --state_sent--> ticking --(answered | missed)--> ticking
    ticking --struck_out | vanished--> lost        any but absent --said_goodbye--> left
    hello, lost, left --greeted--> hello, with a new lease: what the old instance still sends is refused

An agent that has said that it is leaving stays where it is: it goes on answering until its goodbye.

Illegal input raises and changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from wire.errors import MisuseError, Reason, Refused
from wire.messages import Command, Goodbye, Hello, LeaderForce, Leaving


class Phase(StrEnum):
    """Where an agent is in its life."""

    __hash__ = str.__hash__  # the same hash without a call of Python's: the table is asked at every message

    ABSENT = "absent"
    HELLO = "hello"
    READY = "ready"
    TICKING = "ticking"
    LOST = "lost"
    LEFT = "left"


class Event(StrEnum):
    """What can happen to an agent."""

    __hash__ = str.__hash__

    GREETED = "greeted"
    MATCHED = "matched"
    STATE_SENT = "state_sent"
    ANSWERED = "answered"
    MISSED = "missed"
    STRUCK_OUT = "struck_out"
    VANISHED = "vanished"
    SAID_GOODBYE = "said_goodbye"


TRANSITIONS: Mapping[tuple[Phase, Event], Phase] = MappingProxyType(
    {
        (Phase.ABSENT, Event.GREETED): Phase.HELLO,
        (Phase.HELLO, Event.GREETED): Phase.HELLO,  # its welcome was lost on the way, or it died before it was in
        (Phase.LOST, Event.GREETED): Phase.HELLO,
        (Phase.LEFT, Event.GREETED): Phase.HELLO,
        (Phase.HELLO, Event.MATCHED): Phase.READY,
        (Phase.READY, Event.STATE_SENT): Phase.TICKING,
        (Phase.TICKING, Event.STATE_SENT): Phase.TICKING,
        (Phase.TICKING, Event.ANSWERED): Phase.TICKING,
        (Phase.TICKING, Event.MISSED): Phase.TICKING,
        (Phase.TICKING, Event.STRUCK_OUT): Phase.LOST,
        (Phase.HELLO, Event.VANISHED): Phase.LOST,
        (Phase.READY, Event.VANISHED): Phase.LOST,
        (Phase.TICKING, Event.VANISHED): Phase.LOST,
        (Phase.HELLO, Event.SAID_GOODBYE): Phase.LEFT,
        (Phase.READY, Event.SAID_GOODBYE): Phase.LEFT,
        (Phase.TICKING, Event.SAID_GOODBYE): Phase.LEFT,
    }
)
"""The whole life cycle. What is not listed is illegal."""


@dataclass(frozen=True, slots=True)
class Invitation:
    """What the simulator expects of the agent that greets under one name."""

    run: str
    role: str
    name: str
    arm_model: str
    digest: str
    joints: int
    """Number of joints n; 0 for the leader."""
    lost_after: int
    """Missed ticks in a row after which the agent is lost."""


def check_hello(hello: Hello, invitation: Invitation) -> None:
    """Compare a greeting with what is expected under that name.

    Raises:
        Refused: run, role, arm model or digest differ.
    """
    for reason, what, got, expected, fix in (
        (Reason.RUN, "run", hello.run, invitation.run, "Give the simulator's run name with --run"),
        (Reason.ARM, "name", hello.name, invitation.name, "The key and the message must name the same agent"),
        (Reason.ROLE, "role", hello.role, invitation.role, ""),
        (Reason.MODEL, "arm model", hello.arm_model, invitation.arm_model, "Start the follower with this --arm-model"),
        (
            Reason.DIGEST,
            "digest of the arm model",
            hello.digest,
            invitation.digest,
            "The two sides describe the arm differently: install the same release on both",
        ),
    ):
        if got != expected:
            raise Refused(reason, what, got, expected, fix)


GREETING_S = 10.0
"""Wall time that an agent waits for the answer to a greeting before it greets again. The answer comes at once, but from
a simulator that has no core to itself; a second greeting would be refused, since the first was heard."""
LEASES_BETWEEN = 1000
"""More greetings than come between two checkpoints of a simulator."""
REMEMBERED = ("lease", "last_tick", "missed", "longest_miss", "states_sent")
"""Numbers of an agent's life that outlive the simulator; the others belong to one instance of the agent."""


@dataclass(slots=True)
class AgentLink:
    """The simulator's side of one agent's life: phase, lease, the tick that is open, and what was refused."""

    invitation: Invitation
    phase: Phase = Phase.ABSENT
    lease: int = 0
    open_tick: int | None = None
    """The tick whose state is out and not yet answered or given up."""
    last_tick: int = -1
    """The newest tick whose state went out."""
    answered_tick: int | None = None
    """The newest tick that this instance has answered."""
    missed_in_row: int = 0
    missed: int = 0
    longest_miss: int = 0
    """The most ticks missed in a row so far."""
    states_sent: int = 0
    excused: int = 0
    """Ticks that this instance has not answered before its first answer, and that were not counted as missed."""
    leaving: bool = False
    """Whether this instance has said that it puts down what it carries and will then go."""
    refused: dict[str, int] = field(default_factory=dict)
    _greeted_after: int = -1
    """The newest tick that went to an instance before this one."""

    def _move(self, event: Event) -> None:
        try:
            self.phase = TRANSITIONS[self.phase, event]
        except KeyError:
            raise MisuseError(f"agent {self.invitation.name}: {event} cannot happen while {self.phase}") from None

    def greet(self, hello: Hello) -> int:
        """Let an agent in and return its lease. Raises :class:`Refused` if it does not fit or the place is taken."""
        check_hello(hello, self.invitation)
        if (self.phase, Event.GREETED) not in TRANSITIONS:
            raise Refused(
                Reason.TAKEN,
                f"agent {hello.name}",
                f"a second greeting while the first instance is {self.phase}",
                "one instance at a time",
                "Stop the other instance, or wait until it is lost",
            )
        self._move(Event.GREETED)
        self.lease += 1
        self.open_tick = self.answered_tick = None
        self.missed_in_row = self.excused = 0
        self.leaving = False
        self._greeted_after = self.last_tick
        return self.lease

    def matched(self) -> None:
        """Both directions of the link are connected."""
        self._move(Event.MATCHED)

    def state_sent(self, tick: int) -> None:
        """The state of ``tick`` goes out; an answer to it is awaited."""
        if tick <= self.last_tick:
            raise MisuseError(f"agent {self.invitation.name}: tick {tick} sent after tick {self.last_tick}")
        if self.open_tick is not None:
            raise MisuseError(f"agent {self.invitation.name}: tick {tick} sent while {self.open_tick} is open")
        self._move(Event.STATE_SENT)
        self.open_tick = self.last_tick = tick
        self.states_sent += 1

    def answer(self, message: Command | LeaderForce) -> None:
        """Accept the answer to the open tick. Raises :class:`Refused` for any other; then nothing has changed."""
        self._check_answer(message)
        if message.tick < self.last_tick:
            raise Refused(Reason.STALE, "tick", message.tick, self.last_tick)
        if self.open_tick is None and self.missed_in_row:
            raise Refused(Reason.STALE, "tick", message.tick, "its answer before the tick was given up")
        if self.open_tick is None:
            raise Refused(Reason.DUPLICATE, "tick", message.tick, "one answer per tick")
        self._take(message.tick)

    def answer_latest(self, message: Command | LeaderForce) -> None:
        """Real time: accept an answer to any tick since the newest one answered, for a late one is better than none.

        A second answer to a tick is accepted too when newer states are out: so an agent holds that hears them no more.
        It replaces the first, but it is no sign that anybody follows: the tick stays open. Raises :class:`Refused` for
        anything else; then nothing has changed.
        """
        self._check_answer(message)
        newest = self._greeted_after if self.answered_tick is None else self.answered_tick
        if message.tick < newest or (message.tick == newest and self.answered_tick is None):
            raise Refused(Reason.STALE, "tick", message.tick, f"more than {newest}")
        if message.tick == newest == self.last_tick:
            raise Refused(Reason.DUPLICATE, "tick", message.tick, "one answer per tick")
        if message.tick > newest:
            self._take(message.tick)

    def _take(self, tick: int) -> None:
        self._move(Event.ANSWERED)
        self.answered_tick = tick
        self.open_tick = None
        self.missed_in_row = 0

    def _check_answer(self, message: Command | LeaderForce) -> None:
        if isinstance(message, Command):
            self._check_command(message)
        if message.lease != self.lease:
            raise Refused(Reason.LEASE, "lease", message.lease, self.lease, "Another instance has taken over")
        if self.phase is not Phase.TICKING:
            raise Refused(Reason.PHASE, "answer", f"one while {self.phase}", Phase.TICKING)
        if message.tick > self.last_tick:
            raise Refused(Reason.FUTURE, "tick", message.tick, f"at most {self.last_tick}")

    def _check_command(self, command: Command) -> None:
        if command.arm != self.invitation.name:
            raise Refused(Reason.ARM, "arm", command.arm, self.invitation.name)
        for what, vector in (("torque", command.torque), ("stiffness", command.stiffness)):
            if len(vector) != self.invitation.joints:
                raise Refused(Reason.LENGTH, what, len(vector), f"{self.invitation.joints} numbers")

    def miss(self) -> bool:
        """Give the open tick up. True if that was one too many and the agent is now lost."""
        if self.open_tick is None:
            raise MisuseError(f"agent {self.invitation.name}: no open tick to miss")
        self._move(Event.MISSED)
        self.open_tick = None
        self.missed += 1
        self.missed_in_row += 1
        self.longest_miss = max(self.longest_miss, self.missed_in_row)
        if self.missed_in_row < self.invitation.lost_after:
            return False
        self._move(Event.STRUCK_OUT)
        return True

    def excuse(self) -> None:
        """Give the open tick up without counting it: this instance has not come to its first answer yet."""
        if self.open_tick is None or self.answered_tick is not None:
            raise MisuseError(f"agent {self.invitation.name}: no open tick to excuse before a first answer")
        self.open_tick = None
        self.excused += 1

    def vanish(self) -> bool:
        """The agent's sign of life is gone. True if that loses it (it does not if it had left already)."""
        if (self.phase, Event.VANISHED) not in TRANSITIONS:
            return False
        self._move(Event.VANISHED)
        self.open_tick = None
        return True

    def begin_to_leave(self, message: Leaving) -> None:
        """The agent says that it is leaving; once more changes nothing. Raises :class:`Refused` if it is not the one
        that is in."""
        self._check_who_goes(message, "leaving")
        self.leaving = True

    def goodbye(self, message: Goodbye) -> None:
        """The agent has left in order. Raises :class:`Refused` if it is not the one that is in."""
        self._check_who_goes(message, "goodbye")
        self._move(Event.SAID_GOODBYE)
        self.open_tick = None

    def _check_who_goes(self, message: Leaving | Goodbye, what: str) -> None:
        if message.name != self.invitation.name:
            raise Refused(Reason.ARM, "name", message.name, self.invitation.name)
        if message.lease != self.lease:
            raise Refused(Reason.LEASE, "lease", message.lease, self.lease)
        if (self.phase, Event.SAID_GOODBYE) not in TRANSITIONS:
            raise Refused(Reason.PHASE, what, f"one while {self.phase}", "an agent that is in")

    def state(self) -> dict[str, Any]:
        """What a simulator that is started again must know of this agent, in plain values."""
        return {name: getattr(self, name) for name in REMEMBERED} | {"phase": str(self.phase), "refused": self.refused}

    def resume(self, saved: Mapping[str, Any]) -> bool:
        """Go on in a simulator that was started again; True if the agent is awaited.

        Whoever was in is awaited: it greets anew, and gets a lease above all that the simulator before can have given
        since this was saved. Whoever had been lost or had left may come back, as ever.
        """
        phase = Phase(saved["phase"])
        for name in REMEMBERED:
            setattr(self, name, int(saved[name]))
        self.refused = {str(reason): int(times) for reason, times in saved["refused"].items()}
        self.lease += LEASES_BETWEEN
        self.phase = phase if phase in (Phase.LOST, Phase.LEFT) else Phase.ABSENT
        return phase in (Phase.HELLO, Phase.READY, Phase.TICKING)

    def count_refusal(self, reason: Reason) -> None:
        """Remember that a message of this agent was refused."""
        self.refused[reason] = self.refused.get(reason, 0) + 1
