"""The rights as Zenoh enforces them, on passwords and on certificates: what is not allowed does not arrive.

Nothing is proven by waiting. What is forbidden is tried first and what is allowed after it, over the same session;
when the second has arrived, the first would have.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import pytest
from processes import free_port, wait_until

from deploy.authority import issue, new_authority
from deploy.credential_store import CredentialStore
from wire.codec import MAX_BYTES
from wire.credentials import Certificate, Credential, Guests, read_guests
from wire.endpoints import check_stays_here_or_is_proven, parse_endpoint
from wire.errors import CredentialError, LinkError, LoginRefused
from wire.keys import ANY_HELLO, Keys
from wire.zenoh_config import client_config
from wire.zenoh_link import ZenohLink, open_client, open_server

pytestmark = pytest.mark.system

RUN = "silence"
KEYS = Keys(RUN)
A, B, L = KEYS.arm("a1"), KEYS.arm("a2"), KEYS.leader
SOON_S = 2.0
"""A refusal takes a fifth of a second; the rest is for a busy machine. The timeout that it must not be is 10 s."""


@dataclass
class Edge:
    """A simulator's edge: what came in, and a way to send."""

    endpoint: str
    server: ZenohLink
    store: CredentialStore
    came: list[tuple[str, bytes]]

    def login(self, name: str) -> ZenohLink:
        return open_client(self.endpoint, self.store.credential(name))


def serve(stack: ExitStack, store: CredentialStore, protocol: str, guests: Guests | None = None) -> Edge:
    """Listen as the simulator does, and note everything that it hears."""
    endpoint = f"{protocol}/127.0.0.1:{free_port()}"
    server = stack.enter_context(open_server(endpoint, guests or read_guests(store.folder / "sim"), RUN))
    edge = Edge(endpoint, server, store, [])

    def note(key: str) -> Callable[[bytes], None]:
        return lambda payload: edge.came.append((key, payload))

    def note_sign(key: str) -> Callable[[bool], None]:
        return lambda alive: edge.came.append((key, b"alive" if alive else b"gone"))

    for key in (A.command, B.command, L.command, KEYS.order):
        server.subscribe(key, note(key))
    for key in (A.alive, B.alive, L.alive):
        server.watch_alive(key, note_sign(key))
    for expression in ANY_HELLO:
        server.answer_queries(expression, lambda question: question.reply(b"to " + question.key.encode()))
    server.declare_alive(KEYS.sim_alive)
    return edge


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> CredentialStore:
    return CredentialStore.create(tmp_path_factory.mktemp("home") / "team", ["a1", "a2"], days=1, hosts=[])


@pytest.fixture(params=["tcp", "tls"])
def edge(request: pytest.FixtureRequest, store: CredentialStore) -> Iterator[Edge]:
    with ExitStack() as stack:
        yield serve(stack, store, request.param)


# What an agent may do


def test_a_follower_may_do_what_it_needs(edge: Edge) -> None:
    heard: list[bytes] = []
    signs: list[bool] = []
    with edge.login("a1") as a1:
        a1.subscribe(A.state, heard.append)
        a1.watch_alive(KEYS.sim_alive, signs.append)
        command, state = a1.publisher(A.command), edge.server.publisher(A.state)
        assert a1.query(A.hello, b"", 10.0) == b"to " + A.hello.encode()
        a1.declare_alive(A.alive)
        wait_until(command.matched, "its publisher to be matched")
        wait_until(state.matched, "its subscription to be there")
        state.put(b"state")
        command.put(b"command")
        wait_until(lambda: heard and (A.command, b"command") in edge.came and signs, "all of it to arrive")
    wait_until(lambda: (A.alive, b"gone") in edge.came, "its end to be seen")
    assert heard == [b"state"]
    assert signs[0]
    assert edge.came == [(A.alive, b"alive"), (A.command, b"command"), (A.alive, b"gone")]


def test_the_leader_the_observer_and_the_operator_may_do_what_they_need(edge: Edge) -> None:
    with edge.login("leader") as leader, edge.login("observer") as observer, edge.login("operator") as operator:
        ears: dict[str, list[bytes]] = {"leader": [], "observer": [], "operator": []}
        leader.subscribe(L.state, ears["leader"].append)
        observer.subscribe(f"{KEYS.root}/truth/**", ears["observer"].append)
        operator.subscribe(KEYS.progress, ears["operator"].append)
        force, order = leader.publisher(L.command), operator.publisher(KEYS.order)
        for each in (force, order, edge.server.publisher(L.state), edge.server.publisher(KEYS.progress)):
            wait_until(each.matched, "matching")
        assert leader.query(L.hello, b"", 10.0)
        force.put(b"force")
        order.put(b"stop")
        view, progress = edge.server.publisher(L.state), edge.server.publisher(KEYS.progress)

        def all_heard() -> bool:
            view.put(b"view")  # again and again: matched() speaks of one of the two readers of the progress
            progress.put(b"progress")
            return all(ears.values())

        wait_until(all_heard, "everybody to hear")
        wait_until(lambda: len(edge.came) == 2, "both to arrive")
    assert {name: set(heard) for name, heard in ears.items()} == {
        "leader": {b"view"},
        "observer": {b"progress"},
        "operator": {b"progress"},
    }
    assert sorted(edge.came) == sorted([(L.command, b"force"), (KEYS.order, b"stop")])


# What nobody may do

FOREIGN_TO_A1 = {
    "everything": "**",
    "the whole run": f"{KEYS.root}/**",
    "all states": f"{KEYS.root}/arm/*/state",
    "its own state in a wider key": "palanquin/*/arm/a1/state",
    "all of its own keys": f"{KEYS.root}/arm/a1/**",
    "another's state": B.state,
    "another's command": B.command,
    "the load": L.state,
    "the leader's force": L.command,
    "the truth": f"{KEYS.root}/truth/**",
    "the progress": KEYS.progress,
    "the orders": KEYS.order,
    "the admin space": "@/**",
}
SENT = (A.command, B.state, B.command, L.state, L.command, KEYS.progress, KEYS.order)


@pytest.mark.parametrize("key", FOREIGN_TO_A1.values(), ids=FOREIGN_TO_A1)
def test_a_follower_hears_nothing_but_its_state(edge: Edge, key: str) -> None:
    """Everything is put by the simulator itself and by the others who may; a1's own state is put last."""
    stolen: list[bytes] = []
    heard: list[bytes] = []
    with edge.login("a1") as a1, edge.login("a2") as a2, edge.login("operator") as operator:
        a1.subscribe(key, stolen.append)
        # A key of this session's own: `a1` hears its own state where the stolen key includes it, which is no theft.
        with edge.login("a1") as ear:
            ear.subscribe(A.state, heard.append)
            order, command = operator.publisher(KEYS.order), a2.publisher(B.command)
            last = a1.publisher(A.command)
            for each in (order, command, last, edge.server.publisher(A.state)):
                wait_until(each.matched, "matching")
            order.put(b"order")
            command.put(b"command")
            wait_until(lambda: len(edge.came) == 2, "the simulator to hear both")
            for sent in SENT:
                edge.server.publisher(sent).put(b"from the simulator")
            own = edge.server.publisher(A.state)
            own.put(b"own")
            wait_until(lambda: heard, "a1 to hear its own state")
            assert a1.query(A.hello, b"", 10.0)  # a round trip over the session that listened: all before it is here
    assert heard == [b"own"]
    assert stolen == []


@pytest.mark.parametrize("login", ["a1", "leader", "observer", "operator"])
def test_nobody_says_what_is_not_theirs(edge: Edge, login: str) -> None:
    """Those who say anything say it last; the observer's last word is its sign of having left no trace."""
    own = {"a1": A.command, "leader": L.command, "operator": KEYS.order}.get(login)
    with edge.login(login) as link, edge.login("operator") as judge:
        # Held open on the other side, so that matching is not what keeps the puts back.
        for key in (A.command, B.command, L.command, KEYS.order):
            if key != own:
                link.publisher(key).put(b"forged")
        for key in (A.alive, B.alive, L.alive):
            if not (own or "").startswith(key.rpartition("/")[0]):
                link.declare_alive(key)
        if own is not None:
            publisher = link.publisher(own)
            wait_until(publisher.matched, "its own publisher to be matched")
            publisher.put(b"own")
            wait_until(lambda: (own, b"own") in edge.came, "its own word to arrive")
        link.close()  # sends all that it has
        order = judge.publisher(KEYS.order)
        wait_until(order.matched, "the judge's publisher to be matched")
        order.put(b"last")
        wait_until(lambda: (KEYS.order, b"last") in edge.came, "the last word")
    assert edge.came == ([(own, b"own")] if own is not None else []) + [(KEYS.order, b"last")]


def test_a_follower_greets_for_itself_only_and_answers_nobody(edge: Edge) -> None:
    asked: list[str] = []
    with edge.login("a1") as liar, edge.login("a1") as a1, edge.login("a2") as a2:
        for key in (B.hello, *ANY_HELLO, "**"):
            liar.answer_queries(key, lambda question: asked.append(question.key))
        assert a1.query(B.hello, b"", 0.3) is None
        assert a1.query(L.hello, b"", 0.3) is None
        assert a2.query(B.hello, b"", 10.0) == b"to " + B.hello.encode()
        assert a1.query(Keys("other").arm("a1").hello, b"", 10.0)  # a wrong run is told so, by the simulator
    assert asked == []


def test_a_message_that_is_longer_than_any_may_be_stops_at_the_edge(edge: Edge) -> None:
    with edge.login("a1") as a1:
        command = a1.publisher(A.command)
        wait_until(command.matched, "matching")
        for length in (MAX_BYTES + 1, 1_000_000, MAX_BYTES):
            command.put(bytes(length))
        wait_until(lambda: edge.came, "the one that is short enough")
    assert [len(payload) for _, payload in edge.came] == [MAX_BYTES]


# Logins


def refused(endpoint: str, credential: Credential | None) -> str:
    """The sentence of a refused login, which comes soon."""
    start = time.monotonic()
    with pytest.raises(LoginRefused) as error:
        open_client(endpoint, credential)
    assert time.monotonic() - start < SOON_S
    assert error.value.exit_status == 2
    return str(error.value)


def test_a_wrong_password_an_unknown_user_and_no_credential_are_refused(store: CredentialStore) -> None:
    with ExitStack() as stack:
        edge = serve(stack, store, "tcp")
        a1 = store.credential("a1")
        unknown = Credential(replace(a1.who, login="a1.7"), a1.password)
        for credential in (replace(a1, password="guessed"), replace(a1, password=""), unknown):
            assert "refused the credential of a1" in refused(edge.endpoint, credential)
        assert "asks for a credential" in refused(edge.endpoint, None)
        assert "sim" in refused(edge.endpoint, store.credential("sim"))  # it is not its own guest


def test_certificates_of_another_authority_and_expired_ones_are_refused(store: CredentialStore) -> None:
    now = datetime.now(UTC)
    ours = (store.folder / "ca" / "authority.pem").read_text(), (store.folder / "ca" / "authority.key").read_text()
    theirs = new_authority(now)
    a1 = store.credential("a1")
    assert a1.certificate is not None

    def with_certificate(found: Certificate) -> Credential:
        return replace(a1, certificate=found)

    stranger = issue(*theirs, "a1", now, now + timedelta(days=1))
    old = issue(*ours, "a1", now - timedelta(days=3), now - timedelta(hours=1))
    not_its_key = replace(a1.certificate, key=stranger.key)
    with ExitStack() as stack:
        edge = serve(stack, store, "tls")
        for found in (stranger, replace(stranger, authority=ours[0]), old, not_its_key):
            assert "refused the credential of a1" in refused(edge.endpoint, with_certificate(found))
        with pytest.raises(CredentialError, match="needs a certificate"):
            open_client(edge.endpoint, None)


def test_who_shows_no_certificate_is_refused(store: CredentialStore, monkeypatch: pytest.MonkeyPatch) -> None:
    def without(endpoint: str, credential: Credential | None) -> dict[str, object]:
        config = client_config(endpoint, credential)
        tls = config["transport"]["link"]["tls"]
        config["transport"]["link"]["tls"] = {"root_ca_certificate_base64": tls["root_ca_certificate_base64"]}
        return config

    with ExitStack() as stack:
        edge = serve(stack, store, "tls")
        monkeypatch.setattr("wire.zenoh_link.client_config", without)
        refused(edge.endpoint, store.credential("a1"))


def test_an_agent_s_certificate_does_not_pass_for_the_simulator_s(store: CredentialStore) -> None:
    guests = Guests(store.credential("a2"), store.admitted())
    with ExitStack() as stack:
        edge = serve(stack, store, "tls", guests)
        refused(edge.endpoint, store.credential("a1"))


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
@pytest.mark.parametrize("how", ["revoke", "rotate"])
def test_a_revoked_or_replaced_credential_gives_nothing(tmp_path: Path, protocol: str, how: str) -> None:
    """Its login is refused, though a certificate's signature stays good. With somebody else's good password beside the
    old certificate there is a connection, and over it nothing: both must prove the same login."""
    store = CredentialStore.create(tmp_path / "team", ["a1", "a2"], days=1, hosts=[])
    old = store.credential("a1")
    store.revoke("a1") if how == "revoke" else store.rotate("a1", days=1)
    heard: list[bytes] = []
    with ExitStack() as stack:
        edge = serve(stack, store, protocol)
        refused(edge.endpoint, old)
        if protocol == "tcp":
            return
        good = store.credential("a2")
        mixed = replace(good, certificate=old.certificate)
        with open_client(edge.endpoint, mixed) as link, open_client(edge.endpoint, mixed) as accomplice:
            for key in (A.state, "**", KEYS.progress):
                link.subscribe(key, heard.append)
            accomplice.declare_alive(A.alive)
            accomplice.publisher(A.command).put(b"forged")
            assert link.query(A.hello, b"", 0.3) is None
            with edge.login("a2") as a2:
                ear: list[bytes] = []
                a2.subscribe(B.state, ear.append)
                state = edge.server.publisher(B.state)
                wait_until(state.matched, "a2's subscription")
                edge.server.publisher(A.state).put(b"state")
                state.put(b"state")
                wait_until(lambda: ear, "a2 to hear its state")
            assert not edge.server.publisher(A.state).matched()
        if how == "rotate":
            with edge.login("a1") as a1:
                assert a1.query(A.hello, b"", 10.0)
    assert heard == []
    assert edge.came == []


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_an_agent_that_was_in_is_in_again_when_the_simulator_comes_back(store: CredentialStore, protocol: str) -> None:
    """With one try at the opening, Zenoh still reconnects by itself."""
    guests = read_guests(store.folder / "sim")
    endpoint = f"{protocol}/127.0.0.1:{free_port()}"
    heard: list[bytes] = []
    with ExitStack() as stack:
        server = stack.enter_context(open_server(endpoint, guests, RUN))
        command = stack.enter_context(open_client(endpoint, store.credential("a1"))).publisher(A.command)
        for times in (1, 2):
            server.subscribe(A.command, heard.append)
            wait_until(command.matched, "matching")
            command.put(b"here")
            wait_until(partial(heard.__eq__, [b"here"] * times), "the command")
            server.close()
            wait_until(lambda: not command.matched(), "the end to be noticed")
            server = stack.enter_context(open_server(endpoint, guests, RUN))


# Where to listen


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:{}", "tcp/[::]:{}"])
@pytest.mark.parametrize("with_credentials", [False, True])
def test_no_other_machine_gets_in_without_certificates(
    store: CredentialStore, endpoint: str, with_credentials: bool
) -> None:
    endpoint = endpoint.format(free_port())
    guests = read_guests(store.folder / "sim") if with_credentials else None
    with pytest.raises(LinkError, match=r"will not listen on .* tls/.* --insecure-network") as error:
        open_server(endpoint, guests, RUN)
    assert error.value.exit_status == 2
    open_server(endpoint, guests, RUN, insecure_network=True).close()


def test_with_certificates_other_machines_may_come(store: CredentialStore) -> None:
    port = free_port()
    with (
        open_server(f"tls/0.0.0.0:{port}", read_guests(store.folder / "sim"), RUN),
        open_client(f"tls/localhost:{port}", store.credential("a1")),
    ):
        pass


@pytest.mark.parametrize(
    ("endpoint", "hint"),
    [
        ("tcp/[::]:7505", "listen on tls/[::]:7505 with credentials"),
        ("tcp/0.0.0.0:7505", "listen on tls/0.0.0.0:7505 with credentials"),
        ("tls/[::]:7505", "give credentials"),
    ],
)
def test_the_hint_is_an_address_that_can_be_used_and_not_the_one_that_was_given(endpoint: str, hint: str) -> None:
    with pytest.raises(LinkError) as error:
        check_stays_here_or_is_proven(parse_endpoint(endpoint), has_credentials=False, insecure_network=False)
    assert hint in str(error.value)
    assert str(error.value).count(endpoint) == 1


@pytest.mark.parametrize(
    "endpoint",
    [
        *("udp/0.0.0.0:7447", "ws/0.0.0.0:7447", "quic/127.0.0.1:7447", "unixsock-stream/socket", "serial/x:1"),
        *(
            "TCP/0.0.0.0:7447",
            "tcp/*",
            "tcp/*:7447",
            "tcp/::1:7447",
            "tcp/a#iface=eth0:1",
            "tcp/a;tcp/b:1",
            "tcp/a b:1",
        ),
        *("foo", "", "tcp/", "tcp/127.0.0.1", "tcp/127.0.0.1:0", "tcp/127.0.0.1:65536", "tcp/127.0.0.1:" + "9" * 5000),
    ],
)
def test_no_address_but_tcp_and_tls_is_listened_on_or_connected_to(endpoint: str) -> None:
    for use in (open_server, open_client):
        with pytest.raises(LinkError, match=r"^bad address .* expected tcp/<host>:<port> or tls/[^\n]*$") as error:
            use(endpoint)
        assert error.value.exit_status == 2


@pytest.mark.parametrize(
    ("endpoint", "here"),
    [
        ("tcp/127.0.0.1:1", True),
        ("tcp/127.8.9.10:1", True),
        ("tcp/[::1]:1", True),
        ("tls/localhost:1", True),
        ("tcp/0.0.0.0:1", False),
        ("tcp/[::]:1", False),
        ("tcp/192.0.2.1:1", False),
        ("tcp/no.such.host.invalid:1", False),
    ],
)
def test_what_stays_on_this_machine(endpoint: str, here: bool) -> None:
    assert parse_endpoint(endpoint).stays_here() is here
