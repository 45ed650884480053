"""The wish, from outside, that an agent leave in order: put down what it carries, and then go."""

from __future__ import annotations

from collections.abc import Callable


class Departure:
    """What a signal handler (or another thread) and the agent's loop have in common."""

    def __init__(self) -> None:
        self.wanted = False
        self._wake: Callable[[], bool] | None = None

    def heard_by(self, wake: Callable[[], bool]) -> None:
        """From now on the agent looks at :attr:`wanted`, at the latest after ``wake``, if that is true."""
        self._wake = wake

    def ask(self) -> bool:
        """Ask for it; whether the agent will see to it. If not, it has nothing to put down, or was asked before: end it
        at once."""
        if self.wanted or self._wake is None:
            return False
        self.wanted = True
        self.wanted = self._wake()
        return self.wanted
