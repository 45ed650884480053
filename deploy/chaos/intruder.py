"""The intruder: hostile code with the valid credential of one arm tries every row, and says what it got.

The same rows are run against an open simulator, so that "what an open system gives" is measured and not asserted. Some
effects are seen elsewhere: at the simulator's edge (counts of a key in ``audit.json``), or in another follower's log.
Such an attempt names the place, and deploy/chaos/evidence.py looks there after the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import zenoh

from deploy.chaos.attempt import Attempt, Got
from deploy.chaos.host import ON_THE_HOST
from deploy.chaos.listening import LISTENING
from deploy.chaos.speaking import SPEAKING
from deploy.chaos.target import ControlFailedError, Target

ON_THE_WIRE = (*LISTENING, *SPEAKING)
ATTEMPTS = (*ON_THE_HOST, *ON_THE_WIRE)
"""In this order: what could end a run comes last, at the end of ``SPEAKING``."""


@dataclass(frozen=True, slots=True)
class Row:
    """An attempt with what it gave."""

    name: str
    way: str
    got: Got


def try_all(target: Target, attempts: Iterable[Attempt]) -> Iterator[Row]:
    """Every attempt, one after the other. One that Zenoh refuses to a session that works is closed."""
    for each in attempts:
        yield Row(each.name, each.way, _try(target, each.act))


def _try(target: Target, act: Callable[[Target], Got]) -> Got:
    try:
        return act(target)
    except ControlFailedError as error:
        return Got(None, str(error), tested=False)
    except (zenoh.ZError, OSError) as error:
        return Got(False, f"refused: {str(error).splitlines()[0][:80]}")
