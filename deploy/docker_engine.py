"""Deeds done to containers, as deploy/deeds.py does them to processes: `docker kill`, `pause`, `unpause`, `start`, and
`network disconnect` and `connect`.

Containers are found by their labels, so it does not matter who started them. What Docker reports is believed only when
the container's state says it too.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Collection

from deploy.exit_status import COULD_NOT_RUN
from wire.messages import Deed

RUN_LABEL, AGENT_LABEL = "palanquin.run", "palanquin.agent"
"""What the compose files write on every container."""
CONFIRM_S = 15.0
"""Time that the engine gets, for each command and for its effect."""
POLL_S = 0.02

GONE = ("exited", "dead", "created")
COMMANDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "kill": (("kill",), GONE),
    "stop": (("pause",), ("paused",)),
    "continue": (("unpause",), ("running",)),
    "start": (("start",), ("running",)),
    "leave": (("kill", "--signal", "TERM"), ()),
}
"""For each deed Docker's command, and the states of the container that prove it. Nothing proves that a signal came
that its receiver obeys in its own time; that it leaves is seen by the simulator."""


NETWORKS = "{{range $name, $network := .NetworkSettings.Networks}}{{println $name}}{{end}}"
"""What Docker is asked for: names of the networks that a container is in, one a line."""


class EngineError(Exception):
    """The engine cannot be asked, or did not do what it was told."""

    exit_status = COULD_NOT_RUN


class Docker:
    """The containers of one run.

    Args:
        run: name of the run.
        program: the command, or one that takes the same arguments.
    """

    def __init__(self, run: str, program: str = "docker") -> None:
        self._run, self._program = run, program
        self._cut: dict[str, list[str]] = {}
        """By container, the networks that it was cut off from."""

    def version(self) -> str:
        """The engine's version. Raises :class:`EngineError` if there is none that may be asked."""
        return self._ask("version", "--format", "{{.Server.Version}}")

    def do(self, deed: Deed) -> str:
        """Do it; what was in the way, or nothing."""
        try:
            container = self._find(deed.agent)
            state = self.state(container)
            if deed.verb == "start":
                self._reconnect(container)
                if state not in GONE:
                    self._do("kill", container)
            elif state in GONE:
                return f"its container is not running any more ({state})"
            if deed.verb == "disconnect":
                self._disconnect(container)
            elif deed.verb == "reconnect":
                self._reconnect(container)
            else:
                self._do(deed.verb, container)
        except EngineError as error:
            return str(error)
        return ""

    def state(self, container: str) -> str:
        """As Docker names it: created, running, paused, exited, dead."""
        return self._ask("inspect", "--format", "{{.State.Status}}", container)

    def networks(self, container: str) -> list[str]:
        """Names of those that it is in."""
        return self._ask("inspect", "--format", NETWORKS, container).split()

    def _disconnect(self, container: str) -> None:
        """Cut it off from all its networks: it lives on, and nobody hears of it."""
        networks = self.networks(container)
        if not networks:
            raise EngineError("its container is in no network that it could be cut off from")
        for network in networks:
            self._ask("network", "disconnect", network, container)
        if left := self.networks(container):
            raise EngineError(f"its container is still in {', '.join(left)}")
        self._cut[container] = networks

    def _reconnect(self, container: str) -> None:
        """Give it back the networks that it was cut off from."""
        networks = self._cut.pop(container, [])
        for network in networks:
            self._ask("network", "connect", network, container)
        if missing := set(networks) - set(self.networks(container)):
            raise EngineError(f"its container is not in {', '.join(sorted(missing))}")

    def _do(self, verb: str, container: str) -> None:
        if verb not in COMMANDS:
            raise EngineError(f"nothing is known that would do {verb!r} to a container")
        command, proof = COMMANDS[verb]
        self._ask(*command, container)
        self._wait_for(container, proof)

    def _wait_for(self, container: str, states: Collection[str]) -> None:
        deadline = time.monotonic() + CONFIRM_S
        while states and (state := self.state(container)) not in states:
            if time.monotonic() > deadline:
                raise EngineError(f"its container is {state} after {CONFIRM_S:g} s, expected {' or '.join(states)}")
            time.sleep(POLL_S)

    def _find(self, agent: str) -> str:
        labels = (f"label={RUN_LABEL}={self._run}", f"label={AGENT_LABEL}={agent}")
        found = self._ask(
            "ps", "--all", "--quiet", "--no-trunc", "--filter", labels[0], "--filter", labels[1]
        ).splitlines()
        if len(found) != 1:
            raise EngineError(
                f"{len(found)} containers have the labels {RUN_LABEL}={self._run} and {AGENT_LABEL}={agent}, expected "
                "one; remove those of other runs with `docker compose down`"
            )
        return found[0]

    def _ask(self, *arguments: str) -> str:
        """What the command prints. Raises :class:`EngineError`."""
        line = " ".join((self._program, *arguments[:1]))
        try:
            done = subprocess.run(
                [self._program, *arguments], capture_output=True, text=True, timeout=CONFIRM_S, check=False
            )
        except OSError as error:
            raise EngineError(
                f"{self._program}: cannot be run ({error.strerror}); install Docker, or do the events by hand"
            ) from None
        except subprocess.TimeoutExpired:
            raise EngineError(f"`{line}` has not ended within {CONFIRM_S:g} s; is the engine well?") from None
        if done.returncode:
            said = done.stderr.strip().splitlines() or [f"status {done.returncode}"]
            raise EngineError(f"`{line}` failed: {said[-1]}")
        return done.stdout.strip()
