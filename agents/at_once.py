"""Answers on the transport's own thread: the short way from a state to its command, for laws that are quick.

A state that goes through the main thread's queue wakes one thread more, and a command that comes from there another.
But the transport's thread has work of its own, its signs of life among it, so a law is let onto it only after it has
shown that it is quick, and leaves it again at its first slow step.
"""

from __future__ import annotations

from typing import Protocol

from agents.session import AgentSession
from wire.codec import decode
from wire.errors import Refused
from wire.messages import Command, State

QUICK_NS = 5_000_000
"""Wall time that a step may take: a hundredth of the half second after which the sign of life would go."""
QUICK_STEPS = 100
"""In a row, on the main thread, before a law is let onto the transport's: more than it needs to be warm."""


class Answers(Protocol):
    """What is needed of a follower."""

    def check(self, state: State) -> None: ...

    def answer(self, state: State, lease: int, period_s: float) -> Command: ...


class AtOnce:
    """Who answers the states of one follower in lock-step: the main thread, or the transport's.

    Never both at a time: in lock-step no state comes before the one before it is answered.
    """

    def __init__(self, session: AgentSession, follower: Answers, period_s: float) -> None:
        self._session, self._follower, self._period_s = session, follower, period_s
        self._quick = 0

    def note(self, step_ns: int) -> None:
        """The main thread's step took so long; called before its command is sent."""
        self._quick = self._quick + 1 if step_ns < QUICK_NS else 0
        if self._quick == QUICK_STEPS:
            self._session.answer_at_once(self._on_transport)

    def _on_transport(self, payload: bytes) -> bool:
        """Answer a state; whatever else it is, or was wrong with it, is the main thread's."""
        follower, session = self._follower, self._session
        try:
            state = decode(payload, State)
            follower.check(state)
        except Refused:
            return False
        try:
            command = follower.answer(state, session.lease, self._period_s)
        except Exception as error:  # of whatever kind: it ends the process, which is the main thread's to do
            session.answer_at_once(None)
            session.fail(error)
            return True
        if command.step_ns >= QUICK_NS:
            self._quick = 0
            session.answer_at_once(None)
        session.send(command)
        return True
