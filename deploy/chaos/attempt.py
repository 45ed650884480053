"""One thing that an intruder tries, and what it got of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from deploy.chaos.target import Target


@dataclass(frozen=True, slots=True)
class Got:
    """What an attempt gave.

    Attributes:
        is_open: whether it gave what it must not; None: what was seen elsewhere decides (evidence.py).
        evidence: what was seen, in words.
        edge: a key whose count at the simulator's edge tells.
        log: an arm whose follower's log tells.
        refused: the attempt is about its own key: it is closed if the simulator refused it for this reason, and its own
            arm went on.
        tested: whether the intruder's own session worked; if not, the row is neither open nor closed.
    """

    is_open: bool | None
    evidence: str
    edge: str = ""
    log: str = ""
    refused: str = ""
    tested: bool = True
    only_heard: bool = False
    """It is open in that it was heard where it must not be, but it was refused there and changed nothing."""
    sent: int = 0
    """How many messages of its own it sent; a count of refusals beyond that is another attempt's."""


Way = Literal["hear", "speak", "pose", "disturb", "connect", "host"]


@dataclass(frozen=True, slots=True)
class Attempt:
    """One row: what is tried."""

    name: str
    way: Way
    act: Callable[[Target], Got]
