"""The table of rights, as a table: for every role, flow, message and key of the cross product, allowed or denied."""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest

from wire.access import EVERYTHING, TABLE, Principal, Role, access_control, principal
from wire.errors import Refused
from wire.keys import ANY_HELLO, Keys
from wire.memory import key_matches

KEYS = Keys("here")
OTHER = Keys("elsewhere")
A, B, L = KEYS.arm("a1"), KEYS.arm("a2"), KEYS.leader
TEAM = tuple(principal(name) for name in ("a1", "a2", "leader", "observer", "operator"))

SINGLE = [
    *(key for each in (A, B, L) for key in (each.state, each.command, each.hello, each.alive)),
    *(KEYS.sim_alive, KEYS.progress, KEYS.order, "palanquin/here/truth/load", "palanquin/here/operator/fault"),
    *(OTHER.arm("a1").state, OTHER.arm("a1").command, OTHER.arm("a1").hello, OTHER.order, OTHER.progress),
    *("@/here", "somewhere/else", "palanquin", "palanquin/here"),
]
WIDE = [
    *("**", "*", "palanquin/**", "palanquin/here/**", "palanquin/*/arm/a1/state", "palanquin/here/arm/*/state"),
    *("palanquin/here/arm/*/command", "palanquin/here/arm/**", "palanquin/here/arm/a1/**", "palanquin/here/*/alive"),
    *("palanquin/here/truth/**", "palanquin/here/truth/*", "palanquin/*/truth/**", "palanquin/here/operator/**"),
    *("palanquin/here/leader/**", "palanquin/*/arm/a1/hello", "palanquin/*/arm/a2/hello", *ANY_HELLO, "@/**"),
]


def includes(rule: str, key: str) -> bool:
    """Whether a rule's key expression includes all of the one asked for: Zenoh's condition for the rule to apply.

    A ``**`` that is asked for is included by a ``**`` only; a ``*`` by a ``*`` or a ``**``.
    """
    if "**" in key and "**" not in rule:
        return False
    return key_matches(rule, key)


def allows(config: dict[str, Any], login: str, flow: str, message: str, key: str) -> bool:
    """What Zenoh's access control decides with this configuration, for a user name."""
    assert config["enabled"]
    assert config["default_permission"] == "deny"
    ids = {subject["id"] for subject in config["subjects"] if subject["usernames"] == [login]}
    mine = {rule for policy in config["policies"] if ids & set(policy["subjects"]) for rule in policy["rules"]}
    return any(
        rule["id"] in mine
        and rule["permission"] == "allow"
        and flow in rule["flows"]
        and message in rule["messages"]
        and any(includes(expression, key) for expression in rule["key_exprs"])
        for rule in config["rules"]
    )


def expected(login: str) -> set[tuple[str, str, str]]:
    """By hand: everything of the cross product that this login may do."""

    def agent(keys: Any, any_hello: str, base: str) -> set[tuple[str, str, str]]:
        greetings = {keys.hello, f"palanquin/*/{base}/hello"} | ({OTHER.arm("a1").hello} if base == "arm/a1" else set())
        return {
            ("ingress", "declare_subscriber", keys.state),
            ("egress", "put", keys.state),
            ("ingress", "put", keys.command),
            ("egress", "declare_subscriber", keys.command),
            ("ingress", "liveliness_token", keys.alive),
            *(("ingress", "query", key) for key in greetings),
            *(("egress", "reply", key) for key in greetings),
            # The simulator answers greetings with one declaration for all arms; an agent may know that it does.
            *(("egress", "declare_queryable", key) for key in [*SINGLE, *WIDE] if includes(any_hello, key)),
        }

    sim = {
        ("ingress", "declare_liveliness_subscriber", KEYS.sim_alive),
        ("ingress", "liveliness_query", KEYS.sim_alive),
        ("egress", "liveliness_token", KEYS.sim_alive),
    }
    truth = {KEYS.progress, "palanquin/here/truth/load", "palanquin/here/truth/**", "palanquin/here/truth/*"}
    reads = {("ingress", "declare_subscriber", key) for key in truth} | {("egress", "put", key) for key in truth}
    orders = {("ingress", "put", KEYS.order), ("egress", "declare_subscriber", KEYS.order)}
    return {
        "a1": agent(A, ANY_HELLO[0], "arm/a1") | sim,
        "a2": agent(B, ANY_HELLO[0], "arm/a2") | sim,
        "leader": agent(L, ANY_HELLO[1], "leader") | sim,
        "observer": reads | sim,
        "operator": reads | orders | sim,
    }.get(login, set())


@pytest.mark.parametrize("login", ["a1", "a2", "leader", "observer", "operator", "a3", "a1.2", "sim", "router", ""])
def test_every_login_may_do_what_is_written_here_and_nothing_else(login: str) -> None:
    config = access_control("here", TEAM, ("usernames",))
    everything = set(product(("ingress", "egress"), EVERYTHING, [*SINGLE, *WIDE]))
    allowed = {asked for asked in everything if allows(config, login, *asked)}
    assert allowed == {asked for asked in expected(login) if asked in everything}
    assert len(everything) > 600


def test_no_key_can_be_heard_by_two_agents() -> None:
    """The sentence that this is all about, read from the table: puts that go out, per agent."""
    heard = {
        who.name: {
            row.key.format(run="here", arm=who.name)
            for row in TABLE
            if row.role is who.role and row.flow == "egress" and "put" in row.messages
        }
        for who in TEAM[:3]
    }
    assert heard == {"a1": {A.state}, "a2": {B.state}, "leader": {L.state}}


def test_what_one_agent_says_no_other_agent_hears() -> None:
    def keys(who: Principal, flow: str, message: str) -> list[str]:
        rows = (row for row in TABLE if row.role is who.role and row.flow == flow and message in row.messages)
        return [row.key.format(run="here", arm=who.name) for row in rows]

    agents = TEAM[:3]
    for message in ("put", "delete", "query", "reply", "liveliness_token", "declare_subscriber"):
        for sender, hearer in product(agents, agents):
            for said, heard in product(keys(sender, "ingress", message), keys(hearer, "egress", message)):
                assert not key_matches(heard, said)
                assert not key_matches(said, heard)


def test_a_simulator_at_a_router_may_do_everything_in_its_run_and_nothing_in_another() -> None:
    config = access_control("here", (*TEAM, principal("sim")), ("usernames",))
    for flow, message in product(("ingress", "egress"), EVERYTHING):
        for key in (A.state, B.command, L.alive, KEYS.order, *ANY_HELLO):
            assert allows(config, "sim", flow, message, key)
        for key in (OTHER.order, OTHER.arm("a1").state, "**", "palanquin/**"):
            assert not allows(config, "sim", flow, message, key)


def test_a_new_login_has_the_rights_of_its_name_and_the_old_login_has_none() -> None:
    config = access_control("here", (principal("a1", 2),), ("usernames",))
    assert allows(config, "a1.2", "ingress", "put", A.command)
    assert not allows(config, "a1", "ingress", "put", A.command)


def test_certificates_are_told_by_their_common_name() -> None:
    config = access_control("here", TEAM, ("cert_common_names",))
    assert [subject["cert_common_names"] for subject in config["subjects"]] == [[who.login] for who in TEAM]
    assert all("usernames" not in subject for subject in config["subjects"])


@pytest.mark.parametrize("name", ["", "*", "a/b", "**", "A1", "a1\n", "a1:x", "a1.2"])
def test_a_name_that_would_reach_other_keys_is_refused(name: str) -> None:
    with pytest.raises(Refused):
        principal(name)
    with pytest.raises(Refused):
        access_control(name, TEAM, ("usernames",))


@pytest.mark.parametrize(
    ("name", "role", "login"),
    [
        ("leader", Role.FOLLOWER, "leader"),
        ("a1", Role.LEADER, "a1"),
        ("a1", Role.FOLLOWER, "a2"),
        ("a1", Role.FOLLOWER, "a1.x"),
        ("a1", Role.FOLLOWER, "a1.1"),
        ("a1", Role.FOLLOWER, "a1.02"),
        ("a1", Role.FOLLOWER, "a1\nroot"),
    ],
)
def test_a_principal_is_what_its_name_says(name: str, role: Role, login: str) -> None:
    with pytest.raises(Refused):
        Principal(name, role, login)
