"""The operating system's walls around an agent: a hostile controller in a real follower process meets them."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from processes import PALANQUIN, free_port, launched, run_to_end

import sim_server
from deploy.landlock import abi
from deploy.room import room_environment
from deploy.walls import walls_in_log
from wire.zenoh_link import open_server

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

SECRET = "correct-horse"
needs_landlock = pytest.mark.skipif(abi() < 6, reason="this kernel's Landlock lacks a wall")


@dataclass(frozen=True)
class Tried:
    """What a hostile follower got, and what became of its victim."""

    results: dict[str, str]
    victim: int | None
    """How the victim ended; None: it lives."""
    said: str


def try_everything(tmp_path: Path, *walls: str) -> Tried:
    """Start a follower whose controller is hostile, beside a victim of the same user."""
    own, private = tmp_path / "own", tmp_path / "a2" / "credential"
    for folder in (own, private.parent):
        folder.mkdir()
    private.write_text(SECRET)
    abstract = f"palanquin-test-{os.getpid()}"
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        other = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        unix = stack.enter_context(socket.socket(socket.AF_UNIX))
        unix.bind("\0" + abstract)
        unix.listen()
        victim = subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"], env={"SECRET": SECRET})
        stack.callback(victim.wait, 10)
        stack.callback(victim.kill)
        stack.enter_context(open_server(endpoint))  # nobody answers there, but the door is open
        aim = {
            "pid": victim.pid,
            "private": str(private),
            "scenario": str(Path(sim_server.__file__).parent / "scenarios" / "transport.toml"),
            "port": other.getsockname()[1],
            "abstract": abstract,
        }
        words = ["--arm", "a1", "--run", "walls", "--connect", endpoint, "--controller", "hostile:Hostile"]
        words += ["--set", f"aim={json.dumps(json.dumps(aim))}"]
        ended = subprocess.run(
            [PALANQUIN, "follower", *words, *walls],
            cwd=own,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert ended.returncode == 0, ended.stderr
        victim_ended = victim.poll() if walls else victim.wait(10)
        return Tried(json.loads((own / "tried.json").read_text()), victim_ended, ended.stdout)


@pytest.fixture(scope="module")
def inside(tmp_path_factory: pytest.TempPathFactory) -> Tried:
    return try_everything(tmp_path_factory.mktemp("inside"), "--walls")


@pytest.fixture(scope="module")
def outside(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tried]:
    yield try_everything(tmp_path_factory.mktemp("outside"))
    Path("/dev/shm/palanquin-was-here").unlink(missing_ok=True)


@needs_landlock
def test_inside_the_walls_every_attempt_is_denied(inside: Tried) -> None:
    assert {name: got for name, got in inside.results.items() if not got.startswith("denied")} == {}
    assert inside.victim is None
    assert "walls: landlock abi" in inside.said


@needs_landlock
def test_without_walls_the_same_attempts_succeed(outside: Tried) -> None:
    """Else the test above could not fail. What a careful kernel denies to everybody but root is left out."""
    only_root = {"attach as a debugger", "read another's memory"} if os.getuid() else set()
    assert {name for name, got in outside.results.items() if got != "done"} <= only_root
    assert outside.victim == -signal.SIGTERM
    assert "walls" not in outside.said


@pytest.fixture(scope="module")
def curious(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, object]]:
    """Two followers under `palanquin run` tell what they see of themselves."""
    cwd = tmp_path_factory.mktemp("curious")
    (cwd / "hostile.py").write_bytes((Path(__file__).parent / "hostile.py").read_bytes())
    (cwd / "secret.txt").write_text(SECRET)
    values = {"duration_s": 0.2, "team.count": 2, "load.mass_kg": 8.0, "team.controller": "hostile:Curious"}
    values |= {"expect.goal_error_m.max": 3.0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PALANQUIN_TEST_TOKEN", SECRET)
        with launched("transport", cwd, values) as run:
            assert run.command.end() in (0, 1), run.command.said()
    found = {}
    for arm in ("a1", "a2"):
        log = run.folder / "logs" / f"{arm}.log"
        (line,) = [each for each in log.read_text().splitlines() if each.startswith("curious: ")]
        found[arm] = {**json.loads(line.removeprefix("curious: ")), "walls": walls_in_log(log)}
    return found


def test_a_launched_follower_has_a_folder_of_its_own_that_goes_with_it(curious: dict[str, dict[str, object]]) -> None:
    folders = {str(each["cwd"]) for each in curious.values()}
    assert len(folders) == 2
    for folder in folders:
        assert not Path(folder).exists()
    for arm, each in curious.items():
        assert each["inside"] == []
        assert arm not in str(each["cwd"])


def test_a_launched_follower_has_its_own_engine_loaded_and_not_the_simulators(
    curious: dict[str, dict[str, object]],
) -> None:
    assert [each["engines"] for each in curious.values()] == [["pinocchio"]] * 2


def test_a_launched_follower_inherits_no_secret(curious: dict[str, dict[str, object]]) -> None:
    for each in curious.values():
        environment = each["environment"]
        assert isinstance(environment, list)
        assert "PALANQUIN_TEST_TOKEN" not in environment
        assert "PATH" not in environment
        made = {"HOME", "TMPDIR", "PYTHONPATH", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "PYTHONUNBUFFERED"}
        assert set(environment) <= made | {
            "LANG",
            "LANGUAGE",
            "LC_ALL",
            "LC_CTYPE",
            "TZ",
            "LD_LIBRARY_PATH",
            "RUST_LOG",
            "ZENOH_RUNTIME",  # set by our own transport when it is loaded
        }


def test_a_launched_follower_sees_no_path_of_the_run(curious: dict[str, dict[str, object]]) -> None:
    """The path of a log would show the scenario's name, and beside it how many others there are."""
    for each in curious.values():
        assert str(each["output"]).startswith("pipe:")
        assert not any(".log" in str(path) or "/run" in str(path) for path in each["open"])  # type: ignore[attr-defined]


def test_a_launched_follower_is_told_its_arm_and_its_law_and_nothing_of_the_others(
    curious: dict[str, dict[str, object]],
) -> None:
    first, second = (each["arguments"] for each in curious.values())
    assert isinstance(first, list)
    assert isinstance(second, list)
    assert [word.replace("a1", "a2") for word in first] == second
    options = {word for word in first if word.startswith("--")}
    told = {"--credential", "--arm", "--arm-model", "--controller", "--handover-s", "--leave-s", "--set", "--run"}
    assert options <= told | {"--connect", "--walls", "--with-parent", "--reconnect-s"}
    assert first[first.index("--run") + 1] == "carry"  # not the scenario's name


@needs_landlock
def test_a_launched_follower_says_which_walls_stand(curious: dict[str, dict[str, object]]) -> None:
    for each in curious.values():
        for wall in ("files", "programs", "ptrace", "tcp", "signals", "no new privileges"):
            assert wall in str(each["walls"])


def test_walls_on_a_bad_address_are_one_sentence(tmp_path: Path) -> None:
    ended = run_to_end("follower", "--arm", "a1", "--run", "x", "--walls", "--connect", "nowhere", cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert "bad address 'nowhere'" in line
    assert ended.returncode == 2


def test_a_room_gets_what_is_named_and_nothing_else() -> None:
    outer = {"AWS_SECRET_ACCESS_KEY": SECRET, "LANG": "C", "PYTHONPATH": "/mine", "SSH_AUTH_SOCK": "/x", "PATH": "/bin"}
    made = room_environment(outer, Path("/room"), Path("/code"))
    assert made == {"LANG": "C", "HOME": "/room", "TMPDIR": "/room", "PYTHONPATH": "/code:/mine"}
