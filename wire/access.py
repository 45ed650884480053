"""Who may say and hear what: one table, deny by default. It becomes Zenoh's ``access_control``, at the simulator's edge
or at a router's.

Flows are seen from that edge: *ingress* comes from the agent, *egress* goes to it. A rule must include the whole key
expression that is asked for, so a subscription to ``**`` is denied whole, in silence.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

from wire.errors import Reason, Refused
from wire.keys import check_name

Flow = Literal["ingress", "egress"]
Subject = Literal["usernames", "cert_common_names"]
"""How Zenoh tells who is there: by the password's user name, or by the certificate's common name."""


class Role(StrEnum):
    """What a process is in a run."""

    SIM = "sim"
    FOLLOWER = "follower"
    LEADER = "leader"
    OBSERVER = "observer"
    OPERATOR = "operator"
    ROUTER = "router"


MAX_GENERATIONS = 10_000
NAMES_OF_ROLES = {str(role): role for role in Role if role is not Role.FOLLOWER}
"""There is one of each of these, and it bears its role's name. Every other name is an arm's."""


@dataclass(frozen=True, slots=True)
class Row:
    """One permission: what a role may do on a key. ``{run}`` and ``{arm}`` are filled in."""

    role: Role
    flow: Flow
    messages: tuple[str, ...]
    key: str


EVERYTHING = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
)
"""Zenoh's names of all messages that its rules tell apart."""


def _agent(role: Role, base: str, heard: str, said: str, any_hello: str) -> tuple[Row, ...]:
    """The rows of an agent that hears one key, says one key, greets, and shows its own sign of life.

    The greeting's run is left open, as at the simulator: a wrong run is refused with its reason, not met with silence.
    """
    here, greeting = f"palanquin/{{run}}/{base}", f"palanquin/*/{base}/hello"
    return (
        Row(role, "ingress", ("declare_subscriber",), f"{here}/{heard}"),
        Row(role, "egress", ("put",), f"{here}/{heard}"),
        Row(role, "ingress", ("put",), f"{here}/{said}"),
        Row(role, "egress", ("declare_subscriber",), f"{here}/{said}"),  # else its publisher sees no match
        Row(role, "ingress", ("query",), greeting),
        Row(role, "egress", ("reply",), greeting),
        Row(role, "egress", ("declare_queryable",), any_hello),  # the simulator's, as wide as it declares it
        Row(role, "ingress", ("liveliness_token",), f"{here}/alive"),
        *_sees_the_simulator(role),
    )


def _sees_the_simulator(role: Role) -> tuple[Row, ...]:
    key = "palanquin/{run}/sim/alive"
    return (
        Row(role, "ingress", ("declare_liveliness_subscriber", "liveliness_query"), key),
        Row(role, "egress", ("liveliness_token",), key),
    )


def _reads_the_truth(role: Role) -> tuple[Row, ...]:
    key = "palanquin/{run}/truth/**"
    return (
        Row(role, "ingress", ("declare_subscriber",), key),
        Row(role, "egress", ("put",), key),
        *_sees_the_simulator(role),
    )


TABLE: tuple[Row, ...] = (
    *_agent(Role.FOLLOWER, "arm/{arm}", "state", "command", "palanquin/*/arm/*/hello"),
    *_agent(Role.LEADER, "leader", "view", "force", "palanquin/*/leader/hello"),
    *_reads_the_truth(Role.OBSERVER),
    *_reads_the_truth(Role.OPERATOR),
    Row(Role.OPERATOR, "ingress", ("put",), "palanquin/{run}/operator/order"),
    Row(Role.OPERATOR, "egress", ("declare_subscriber",), "palanquin/{run}/operator/order"),
    # The simulator, when it is a client of a router. At its own edge no rule holds it.
    *(
        Row(Role.SIM, flow, EVERYTHING, key)
        for flow in ("ingress", "egress")
        for key in ("palanquin/{run}/**", "palanquin/*/arm/*/hello", "palanquin/*/leader/hello")
    ),
)
"""All that is allowed. What is not here is denied."""


@dataclass(frozen=True, slots=True)
class Principal:
    """Somebody with a credential.

    Attributes:
        name: an arm's name, or the role's for the others.
        login: user name and common name. A credential made anew has a new one (``a1.2``), so that the old is useless.
    """

    name: str
    role: Role
    login: str

    def __post_init__(self) -> None:
        check_name("name", self.name)
        if NAMES_OF_ROLES.get(self.name, Role.FOLLOWER) is not self.role:
            raise Refused(Reason.ROLE, "name", self.name, "an arm's name, or its own role's", "Choose another name")
        name, _, generation = self.login.partition(".")
        if name != self.name or (generation or "2") not in map(str, range(2, MAX_GENERATIONS)):
            raise Refused(Reason.MALFORMED, "login", repr(self.login), f"{self.name}, or {self.name}.2 and so on")


def principal(name: str, generation: int = 1) -> Principal:
    """The principal of that name, with its first login or a later one. Raises :class:`Refused` for a bad name."""
    login = name if generation == 1 else f"{name}.{generation}"
    return Principal(name, NAMES_OF_ROLES.get(name, Role.FOLLOWER), login)


def access_control(run: str, principals: Iterable[Principal], by: Sequence[Subject]) -> dict[str, Any]:
    """Zenoh's ``access_control`` for one run: the table's rows for each principal, and nothing for anybody else.

    Args:
        by: what proves the login; with several, all of them must.

    Raises:
        Refused: the run's name cannot be part of a key.
    """
    check_name("run", run)
    rules, subjects, policies = [], [], []
    for who in principals:
        theirs = [row for row in TABLE if row.role is who.role]
        for number, row in enumerate(theirs):
            rules.append(
                {
                    "id": f"{who.login}-{number}",
                    "permission": "allow",
                    "flows": [row.flow],
                    "messages": list(row.messages),
                    "key_exprs": [row.key.format(run=run, arm=who.name)],
                }
            )
        subjects.append({"id": who.login} | {str(proof): [who.login] for proof in by})
        policies.append({"rules": [f"{who.login}-{n}" for n in range(len(theirs))], "subjects": [who.login]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }
