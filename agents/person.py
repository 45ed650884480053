"""A person who leads: the newest wish, as it arrives on another thread, and the wish to go."""

from __future__ import annotations

import logging
from collections.abc import Callable

from agents.departure import Departure
from agents.wish import MAX_LINE, NoWish, Wish

log = logging.getLogger("palanquin.leader")


class Person:
    """Hears lines (see :mod:`agents.wish`) and keeps the newest wish for the leader's next look.

    Args:
        end_at_once: ends the process when the person goes before any simulator has let the leader in.
        tell: is given every wish, to show it.
    """

    def __init__(self, end_at_once: Callable[[], None], tell: Callable[[Wish], None] = lambda wish: None) -> None:
        self.wish = Wish()
        self.departure = Departure()
        self._end_at_once, self._tell = end_at_once, tell
        self._rest = b""
        self._complained = False

    def hear(self, said: bytes) -> None:
        """Take in what was said, cut anywhere. What is no wish is skipped, and the log says so once."""
        *lines, self._rest = (self._rest + said).split(b"\n")
        self._rest = self._rest[-2 * MAX_LINE :]  # so long that it is refused, and no longer
        for line in lines:
            try:
                self._want(Wish.read(line) if len(line) <= MAX_LINE else _refuse(line))
            except NoWish as problem:
                if not self._complained:
                    self._complained = True
                    log.warning("leader: %s", problem)

    def hear_end(self) -> None:
        """Nobody will say anything more: the person, or the device, has gone. Who has no hand on the load lets go."""
        if not self.wish.leave:
            self._want(Wish(leave=True))

    def _want(self, wish: Wish) -> None:
        if self.wish.leave:
            return
        self.wish = wish
        self._tell(wish)
        if wish.leave and not self.departure.ask():
            self._end_at_once()


def _refuse(line: bytes) -> Wish:
    raise NoWish(f"wish of {len(line)} bytes: expected at most {MAX_LINE}")
