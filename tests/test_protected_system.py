"""Runs behind credentials as real processes: by hand over mutual TLS, through a router, what a launched run hides."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from processes import (
    Started,
    free_port,
    launched,
    read_json,
    run_to_end,
    settings,
    started,
)

from deploy.agents_told import leader_arguments
from deploy.credential_store import CredentialStore
from deploy.router_file import write_router_file
from sim_server.scenario_files import load_scenario
from wire.access import principal
from wire.credentials import Credential
from wire.keys import Keys
from wire.link import Link
from wire.private_files import write_private
from wire.zenoh_link import open_client

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

RUN = "guarded"
KEYS = Keys(RUN)
ARMS = ("a1", "a2")
TEAM = {"team.count": 2, "load.mass_kg": 8.0}
FOREIGN = (KEYS.arm("a2").state, KEYS.leader.state, f"{KEYS.root}/truth/**")
EVERYTHING = ("**", "palanquin/**")
"""What the spy asks for, besides: these reach its own key as well."""


@dataclass
class Ears:
    """What an eavesdropper with a1's credential heard, by key expression."""

    heard: dict[str, list[bytes]] = field(default_factory=dict)

    def listen(self, link: Link, *keys: str) -> None:
        for key in keys:
            self.heard[key] = []
            link.subscribe(key, self.heard[key].append)

    def counts(self, *keys: str) -> dict[str, int]:
        return {key: len(self.heard[key]) for key in keys}


@dataclass
class Guarded:
    """How a run behind credentials went."""

    folder: Path
    statuses: dict[str, int]
    ears: Ears
    before: dict[str, int]
    """How much the spy had heard when it was let hear what it may."""
    control: list[bytes]
    """What it heard of that."""
    wrong: dict[str, tuple[int, str]]


def run_guarded(cwd: Path, protocol: str, *, router: bool) -> Guarded:
    """A run by hand, with an eavesdropper, and with followers who come with the wrong credential."""
    port = free_port()
    endpoint = f"{protocol}/127.0.0.1:{port}"
    store = CredentialStore.create(cwd / "team", [*ARMS, "a3"], days=1, hosts=[])
    store.revoke("a3")
    folder, ears = cwd / "run", Ears()
    wrong: dict[str, tuple[int, str]] = {}
    with ExitStack() as stack:

        def start(name: str, *arguments: str | Path) -> Started:
            return stack.enter_context(started(*arguments, cwd=cwd, name=name))

        place: tuple[str | Path, ...] = ("--listen", endpoint)
        if router:
            file = ("--router-config", "router.json5", "--run", RUN, "--listen", endpoint)
            made = run_to_end("credentials", "team", *file, cwd=cwd)
            assert made.returncode == 0, made.stderr
            between = start("router", "router", "--config", "router.json5")
            between.wait_until(lambda: "router of router.json5" in between.said(), "the router")
            place = ("--connect-router", endpoint)
        serve = ("--credentials", "team/sim", "--run", RUN, *place, *settings({**TEAM, "duration_s": 1.0}))
        sim = start("sim", "sim", "transport", "--out", folder, *serve)
        sim.wait_until(lambda: f"run {RUN} at {endpoint}, waiting for a1" in sim.said(), "the simulator")

        def follower(arm: str, folder: str, name: str) -> Started:
            agent = ("--run", RUN, "--connect", endpoint, "--credential", folder)
            return start(name, "follower", "--arm", arm, *agent)

        strangers = {"another_arm": follower("a2", "team/a1", "another_arm")}
        for name, stranger in strangers.items():
            wrong[name] = stranger.end(), stranger.errors.read_text()
        spy = stack.enter_context(open_client(endpoint, store.credential("a1")))
        ears.listen(spy, *FOREIGN, *EVERYTHING)
        ear = stack.enter_context(open_client(endpoint, store.credential("a1")))
        ears.listen(ear, KEYS.arm("a1").state)
        observer = stack.enter_context(open_client(endpoint, store.credential("observer")))
        ears.listen(observer, KEYS.progress)
        team = {arm: follower(arm, f"team/{arm}", arm) for arm in ARMS}
        scenario = load_scenario("transport").scenario
        lead = ("--run", RUN, "--connect", endpoint, "--credential", "team/leader")
        team["leader"] = start("leader", "leader", *lead, *leader_arguments(scenario))
        sim.wait_until(lambda: len(ears.heard[KEYS.arm("a1").state]) >= 300, "a third of the run")
        before = ears.counts(*FOREIGN, *EVERYTHING)
        control: list[bytes] = []
        spy.subscribe(KEYS.arm("a1").state, control.append)
        statuses = {"sim": sim.end(), **{name: agent.end() for name, agent in team.items()}}
    return Guarded(folder, statuses, ears, before, control, wrong)


@pytest.fixture(
    scope="module", params=[("tls", False), ("tcp", True), ("tls", True)], ids=["tls", "router", "router-tls"]
)
def guarded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Guarded:
    protocol, router = request.param
    return run_guarded(tmp_path_factory.mktemp("guarded"), protocol, router=router)


def test_a_run_behind_credentials_completes_with_a_verdict(guarded: Guarded) -> None:
    assert guarded.statuses == {"sim": 1, "a1": 0, "a2": 0, "leader": 0}  # 1: one second does not reach the goal
    run = read_json(guarded.folder / "run.json")
    assert run["ended"] == {"completed": True, "why": "reached its duration", "ticks": 1000}
    assert read_json(guarded.folder / "metrics.json")["verdict"] == "violated"
    for agent in run["agents"].values():
        assert (agent["phase"], agent["lease"], agent["missed_ticks"], agent["refused"]) == ("ticking", 1, 0, {})


def test_who_listens_with_the_credential_of_an_arm_hears_that_arm_and_nobody_else(guarded: Guarded) -> None:
    heard, own = guarded.ears.heard, KEYS.arm("a1").state
    assert len(heard[own]) > 900
    assert len(heard[KEYS.progress]) > 0  # the observer, who may
    assert guarded.before == dict.fromkeys([*FOREIGN, *EVERYTHING], 0)
    # Then the spy's session asked for the state of its own arm: it works, and to the end it got that and nothing else.
    assert guarded.control
    assert guarded.ears.counts(*FOREIGN) == dict.fromkeys(FOREIGN, 0)
    assert {payload for key in EVERYTHING for payload in heard[key]} <= set(heard[own])
    assert set(heard) == {own, KEYS.progress, *FOREIGN, *EVERYTHING}


def test_the_credential_of_another_arm_is_one_clear_sentence_and_status_2(guarded: Guarded) -> None:
    status, said = guarded.wrong["another_arm"]
    (line,) = said.splitlines()
    assert line == ("palanquin: this credential is for a1, not for a2: give the folder of a2 with --credential")
    assert status == 2


@pytest.fixture(scope="module")
def launched_trace(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The same run, launched on one machine."""
    with launched("transport", tmp_path_factory.mktemp("launched"), {**TEAM, "duration_s": 1.0}) as run:
        run.command.end()
    return (run.folder / "trace.parquet").read_bytes()


def test_the_trace_is_the_same_bytes_whatever_lies_between(launched_trace: bytes, guarded: Guarded) -> None:
    """Access rules, TLS and a router cost time and nothing else."""
    assert (guarded.folder / "trace.parquet").read_bytes() == launched_trace


# A launched run


MARKER = "a-password-that-can-be-found"
MARKED = f"""
import sys
if "run" in sys.orig_argv:
    from wire import credentials
    credentials.new_password = lambda: "{MARKER}"
"""


def test_a_launched_run_hides_its_passwords_and_lets_nobody_in(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No file, no argument and no environment has them; without one, nothing opens."""
    elsewhere = tmp_path_factory.mktemp("site")
    (elsewhere / "sitecustomize.py").write_text(MARKED)
    monkeypatch.setenv("PYTHONPATH", str(elsewhere))
    with launched("transport", tmp_path, {**TEAM, "duration_s": 6.0}) as run:
        run.wait_until_carrying(0.1)
        endpoint = f"tcp/127.0.0.1:{run.port}"
        open_client(endpoint, Credential(principal("a1"), MARKER)).close()  # it is the password
        ended = run_to_end("follower", "--arm", "a1", "--run", "carry", "--connect", endpoint, cwd=tmp_path)
        assert set(run.children) == {"sim", "a1", "a2", "leader"}
        seen = [(child.cmdline(), child.environ(), child.open_files()) for child in run.children.values()]
        rooms = {Path(child.cwd()) for name, child in run.children.items() if name != "sim"}
        assert len(rooms) == 3
        written = b"".join(path.read_bytes() for room in rooms for path in room.rglob("*") if path.is_file())
    (line,) = ended.stderr.splitlines()
    assert "asks for a credential" in line
    assert ended.returncode == 2
    for arguments, environment, files in seen:
        assert [each for each in arguments if "password" in each] == []
        assert [name for name in environment if "PALANQUIN" in name or "PASSWORD" in name] == []
        assert [file.path for file in files if "credential" in file.path or "guests" in file.path] == []
        assert [text for text in (*arguments, *environment.values()) if MARKER in text] == []
    written += b"".join(path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())
    assert b"password" not in written
    assert MARKER.encode() not in written


# A simulator by hand


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "who may connect? Make credentials with `palanquin credentials DIR --arms 4`"),
        (["--open", "--credentials", "x"], "exclude each other"),
        (["--credentials", "x"], "x: no credential"),
        (["--open", "--listen", "tcp/0.0.0.0:{port}"], "--insecure-network"),
        (["--open", "--listen", "tls/127.0.0.1:{port}"], "a tls/ address needs a certificate"),
    ],
)
def test_a_simulator_that_would_be_open_by_mistake_does_not_start(
    tmp_path: Path, arguments: list[str], said: str
) -> None:
    filled = [each.format(port=free_port()) for each in arguments]
    ended = run_to_end("sim", "hold", *filled, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert said in line
    assert ended.returncode == 2
    assert list(tmp_path.iterdir()) == []


def test_an_open_simulator_says_that_it_is(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with started("sim", "hold", "--open", "--listen", endpoint, cwd=tmp_path) as sim:
        sim.wait_until(lambda: "waiting for" in sim.said(), "the simulator")
        assert "open: no access rules" in sim.said()
        open_client(endpoint).close()


NOT_OURS = {"bad": "{mode: 'router'}", "worse": "{", "empty": "{}", "list": "[1]", "text": "hello", "nul": "\0"}


def test_a_router_without_a_good_file_does_not_start(tmp_path: Path) -> None:
    for name, text in NOT_OURS.items():
        write_private(tmp_path / f"{name}.json5", text)
        assert f"{name}.json5: not a router's configuration of ours" in refused_router(tmp_path, f"{name}.json5")
    assert "none.json5: cannot be read" in refused_router(tmp_path, "none.json5")


def refused_router(cwd: Path, file: str) -> str:
    """The one sentence of a router that does not start."""
    ended = run_to_end("router", "--config", file, cwd=cwd)
    (line,) = ended.stderr.splitlines()
    assert ended.returncode == 2
    return line


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_router_does_not_start_without_its_rules_or_with_secrets_that_others_may_read(
    tmp_path: Path, protocol: str
) -> None:
    store = CredentialStore.create(tmp_path / "team", ["a1"], days=1, hosts=[])
    written = write_router_file(store, tmp_path / "r.json5", RUN, f"{protocol}/127.0.0.1:{free_port()}")
    for file in written:
        file.chmod(0o644)
        assert f"{file.name}: others may read it (mode 0644)" in refused_router(tmp_path, "r.json5")
        file.chmod(0o600)
    ours = written[0].read_text()
    assert '"default_permission": "deny"' in ours
    write_private(tmp_path / "r.json5", ours.replace('"default_permission": "deny"', '"default_permission": "allow"'))
    assert "default_permission" in refused_router(tmp_path, "r.json5")
    write_private(tmp_path / "r.json5", ours.replace(f'"{protocol}/127.0.0.1', '"udp/127.0.0.1'))
    assert "bad address 'udp/" in refused_router(tmp_path, "r.json5")
    write_private(tmp_path / "r.json5", ours.replace("127.0.0.1:", "0.0.0.0:").replace('"tls/', '"tcp/'))
    assert "will not listen on tcp/0.0.0.0" in refused_router(tmp_path, "r.json5")
