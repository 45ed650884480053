"""A launched run that a person leads: the launcher has the terminal, the leader its walls, and lines go from one to the
other over the leader's standard input.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console

from agents.wish import Wish
from deploy.person.attending import HELP, attended
from sim_server.scenario import Scenario

LOCK_STEP = (
    "the clock is lock-step: simulated time waits for the arms and not for you, what you want is looked at once a "
    "view, and the run will not repeat; clock.mode = 'real-time' goes by the wall clock, as transport-real-time does"
)


@contextmanager
def led(scenario: Scenario, tell: Callable[[bytes], None], console: Console) -> Iterator[Callable[[], str]]:
    """Have the scenario's person lead, if it has one: ``tell`` is given each line. What to say of it to those who watch
    is given back.

    Raises:
        CannotAttend: there is no such device here.
    """
    leader = scenario.leader
    if leader is None or leader.by == "law":
        yield lambda: "carrying"
        return
    newest, most = Wish(), leader.force_max_N

    def hear(line: bytes) -> None:
        nonlocal newest
        newest = Wish.read(line)
        tell(line)

    with attended(leader.by) as person:
        console.print(HELP[leader.by], highlight=False, soft_wrap=True, markup=False)
        if scenario.clock.mode == "lock-step":
            console.print(LOCK_STEP, highlight=False, soft_wrap=True, markup=False)
        person.hand_on(hear, lambda: hear(Wish(leave=True).line()))
        yield lambda: newest.says(most)
