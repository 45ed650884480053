"""Key expressions: who may say what where. ``palanquin/<run>/...``; no key reaches two agents."""

from __future__ import annotations

import re
from dataclasses import dataclass

from wire.errors import Reason, Refused

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,39}")


def check_name(what: str, name: str) -> str:
    """Return ``name`` if it can be part of a key: lower case letters, digits, ``-`` and ``_``, at most 40.

    Raises:
        Refused: it cannot (a ``/`` or ``*`` in a name would reach other keys).
    """
    if not _NAME.fullmatch(name):
        raise Refused(Reason.MALFORMED, what, repr(name), "1 to 40 of a-z 0-9 - _, first a letter or digit")
    return name


@dataclass(frozen=True, slots=True)
class ArmKeys:
    """The four keys of one arm."""

    state: str
    command: str
    hello: str
    alive: str


@dataclass(frozen=True, slots=True)
class Keys:
    """All keys of one run."""

    run: str

    def __post_init__(self) -> None:
        check_name("run", self.run)

    @property
    def root(self) -> str:
        return f"palanquin/{self.run}"

    def arm(self, arm: str) -> ArmKeys:
        """Keys of one arm: state (sim -> agent), command (agent -> sim), hello (query), alive (liveliness)."""
        base = f"{self.root}/arm/{check_name('arm', arm)}"
        return ArmKeys(f"{base}/state", f"{base}/command", f"{base}/hello", f"{base}/alive")

    @property
    def leader(self) -> ArmKeys:
        """Keys of the leader: the same four roles as an arm's (``state`` is the view of the load, ``command`` the
        force)."""
        base = f"{self.root}/leader"
        return ArmKeys(f"{base}/view", f"{base}/force", f"{base}/hello", f"{base}/alive")

    @property
    def sim_alive(self) -> str:
        """Liveliness token of the simulator."""
        return f"{self.root}/sim/alive"

    @property
    def progress(self) -> str:
        """How the run goes: for observers only."""
        return f"{self.root}/truth/progress"

    @property
    def rows(self) -> str:
        """What is recorded of a tick: for observers only."""
        return f"{self.root}/truth/rows"

    @property
    def events(self) -> str:
        """What happens: for observers only."""
        return f"{self.root}/truth/events"

    @property
    def deeds(self) -> str:
        """What the scenario wants done to processes: for the launcher."""
        return f"{self.root}/truth/deeds"

    @property
    def order(self) -> str:
        """Orders of the operator (the launcher) to the simulator, and its reports of deeds done."""
        return f"{self.root}/operator/order"


ANY_HELLO = ("palanquin/*/arm/*/hello", "palanquin/*/leader/hello")
"""Where the simulator answers greetings: any run and any arm, so that a wrong name is refused with its reason."""
