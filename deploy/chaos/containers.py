"""``palanquin chaos deeds``: what a scenario wants done to processes, done to containers.

Runs on the machine of the engine and in no container: whoever may kill containers may do anything to that machine.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from deploy.deeds import Doer
from deploy.docker_engine import Docker
from wire.credentials import Credential
from wire.endpoints import parse_endpoint
from wire.errors import LinkError
from wire.keys import Keys
from wire.messages import Deed
from wire.zenoh_link import ZenohLink, open_client

POLL_S = 0.1
GREET_S = 5.0
"""Time from the connection to the simulator's sign of life."""

Say = Callable[[str], None]


def do_deeds(docker: Docker, run: str, connect: str, own: Credential | None, wait_s: float, say: Say) -> int:
    """Wait for the simulator, then do all that it asks for until it is gone; how many deeds could not be done.

    Args:
        wait_s: wall time that the simulator has to be there.
        say: is told of each deed.

    Raises:
        EngineError: there is no engine.
        LinkError: nobody answers at ``connect`` in time, this credential is not let in, or the run is another one.
    """
    keys = Keys(run)
    parse_endpoint(connect)
    version = docker.version()
    is_there, is_gone = threading.Event(), threading.Event()
    failed = 0

    def do(deed: Deed) -> str:
        nonlocal failed
        began = time.monotonic()
        problem = docker.do(deed)
        failed += bool(problem)
        say(f"{deed.agent}: {deed.verb}: {problem or f'done in {time.monotonic() - began:.2f} s'}")
        return problem

    with _open_patiently(connect, own, wait_s) as link:
        link.watch_alive(keys.sim_alive, lambda alive: (is_there if alive else is_gone).set())
        doer = Doer(link, run, do)
        if not is_there.wait(GREET_S):
            raise LinkError(f"{connect}: no simulator there that runs {run!r}; say which run with --run")
        say(f"engine {version}: does what the scenario of the run {run!r} wants done to its containers")
        while not is_gone.is_set():
            doer.do_for(POLL_S)
    say("the simulator is gone")
    return failed


def _open_patiently(connect: str, own: Credential | None, wait_s: float) -> ZenohLink:
    """Try until ``wait_s`` is over, also where somebody listens and lets nobody in: the engine's own door to a
    container is open before the simulator behind it is."""
    deadline = time.monotonic() + wait_s
    while True:
        try:
            return open_client(connect, own, timeout_s=1.0)
        except LinkError:
            if time.monotonic() > deadline:
                raise
        time.sleep(POLL_S)
