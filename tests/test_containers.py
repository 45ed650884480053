"""A carry in real containers: who reaches whom, what each may, and that what happens to a container is, byte for byte,
what happens to a process.

Needs a Docker engine, Compose, and the images of `make images`; `make test-containers` does it all.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from processes import free_port, read_events, read_json, run_to_end, started, wait_until

pytestmark = [pytest.mark.containers, pytest.mark.timeout(600)]

DEPLOY = Path(__file__).resolve().parent.parent / "deploy"
UID = os.getuid() or 1000
"""Whom the containers run as; root makes its files over to somebody else."""

STORY = """
extends = "transport"
description = "Two arms and a light table; a2 is killed, started, paused for five ticks, then for good, started again."
duration_s = 2.0
[team]
count = 2
[load]
mass_kg = 8.0
[clock]
start_timeout_s = 120.0
[[events]]
at_s = 0.3
kind = "kill"
agent = "a2"
[[events]]
at_s = 0.6
kind = "start"
agent = "a2"
[[events]]
at_s = 1.0
kind = "stop"
agent = "a2"
[[events]]
at_s = 1.005
kind = "continue"
agent = "a2"
[[events]]
at_s = 1.2
kind = "stop"
agent = "a2"
[[events]]
at_s = 1.4
kind = "start"
agent = "a2"
[[events]]
at_s = 1.6
kind = "kill"
agent = "leader"
"""

REACH = """
import socket, sys
def answers(kind, protocol, address, say):
    with socket.socket(socket.AF_INET, kind, protocol) as way:
        way.settimeout(2.0)
        try:
            way.connect(address)
            if say:
                way.send(say)
                way.recv(64)
            return True
        except OSError:
            return False
ECHO = bytes([8, 0, 0, 0, 0, 0, 0, 1])
for host in sys.argv[1:]:
    ping = answers(socket.SOCK_DGRAM, socket.IPPROTO_ICMP, (host, 0), ECHO)
    tcp = answers(socket.SOCK_STREAM, 0, (host, 7447), b"")
    print(host, int(ping), int(tcp))
"""
"""Run inside a container: whether each address answers a ping, and takes a connection on the simulator's port."""


def compose_command() -> list[str] | None:
    for command in (["docker", "compose"], ["docker-compose"]):
        if shutil.which(command[0]) and subprocess.run([*command, "version"], capture_output=True).returncode == 0:
            return command
    return None


def docker(*arguments: str, given: str = "") -> str:
    done = subprocess.run(["docker", *arguments], input=given, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@dataclass
class Carry:
    """The containers of one carry, and its folders on this machine."""

    compose: Sequence[str]
    project: str
    place: Path
    environment: dict[str, str]

    def up(self, *services: str) -> None:
        self._compose("up", "--detach", "--no-build", *services)

    def down(self) -> None:
        self._compose("down", "--volumes", "--timeout", "1")

    def container(self, service: str) -> str:
        project = f"label=com.docker.compose.project={self.project}"
        return docker("ps", "-aq", "--filter", project, "--filter", f"label=com.docker.compose.service={service}")

    @property
    def run(self) -> Path:
        """The run folder, which the simulator's container writes."""
        return self.place / "runs" / "carry"

    def joined(self) -> set[str]:
        return {str(event["agent"]) for event in read_events(self.run) if event["kind"] == "joined"}

    def look(self, service: str) -> Any:
        return json.loads(docker("inspect", self.container(service)))[0]

    def address(self, service: str, network: str) -> str:
        found: str = self.look(service)["NetworkSettings"]["Networks"][f"{self.project}_{network}"]["IPAddress"]
        return found

    def reached(self, service: str, *addresses: str) -> dict[str, tuple[bool, bool]]:
        """From a service: whether each address answers a ping, and takes a connection."""
        lines = docker("exec", "-i", self.container(service), "python3", "-", *addresses, given=REACH).splitlines()
        return {host: (ping == "1", tcp == "1") for host, ping, tcp in map(str.split, lines)}

    def _compose(self, *arguments: str) -> None:
        files = ("-f", str(DEPLOY / "compose.yaml"), "-f", str(DEPLOY / "compose.chaos.yaml"))
        line = [*self.compose, "-p", self.project, *files, *arguments]
        done = subprocess.run(line, env=self.environment, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def carry(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Carry]:
    """The simulator and two followers in containers; the run waits for the leader."""
    compose = compose_command()
    images = ("palanquin-follower", "palanquin-sim")
    if compose is None or subprocess.run(["docker", "image", "inspect", *images], capture_output=True).returncode:
        pytest.skip("needs a Docker engine, Compose, and the images of `make images`")
    place = tmp_path_factory.mktemp("containers")
    place.chmod(0o755)
    (place / "runs").mkdir()
    (place / "runs" / "story.toml").write_text(STORY)
    made = run_to_end("credentials", "team", "--arms", "4", "--host", "sim", cwd=place)
    assert made.returncode == 0, made.stderr
    if os.getuid() == 0:
        for folder, _, files in os.walk(place):
            for path in (folder, *(os.path.join(folder, file) for file in files)):
                os.chown(path, UID, UID)
    environment = {
        **os.environ,
        "PALANQUIN_USER": f"{UID}:{UID}",
        "PALANQUIN_TEAM": str(place / "team"),
        "PALANQUIN_RUNS": str(place / "runs"),
        "PALANQUIN_SCENARIO": "runs/story.toml --out runs/carry",
        "PALANQUIN_PORT": str(free_port()),
    }
    carry = Carry(compose, f"palanquin-test-{secrets.token_hex(4)}", place, environment)
    try:
        carry.up("sim", "a1", "a2")
        wait_until(lambda: carry.joined() >= {"a1", "a2"}, "the followers to have joined")
        yield carry
    finally:
        carry.down()


def test_followers_reach_the_simulator_and_nobody_else(carry: Carry) -> None:
    for own, other in (("a1", "a2"), ("a2", "a1")):
        simulator, follower = carry.address("sim", own), carry.address(other, other)
        simulator_elsewhere = carry.address("sim", other)
        this_machine = docker(
            "network", "inspect", "-f", "{{(index .IPAM.Config 0).Gateway}}", f"{carry.project}_{own}"
        )
        reached = carry.reached(own, simulator, follower, simulator_elsewhere, this_machine)
        assert reached.pop(simulator) == (True, True)
        assert reached == dict.fromkeys((follower, simulator_elsewhere, this_machine), (False, False))


def test_a_follower_is_nobody_may_nothing_and_writes_nothing(carry: Carry) -> None:
    container = carry.container("a1")
    status = dict(line.split(":\t", 1) for line in docker("exec", container, "cat", "/proc/1/status").splitlines())
    assert {status[kind] for kind in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")} == {"0" * 16}
    assert status["NoNewPrivs"] == "1"
    assert status["Uid"].split() == [str(UID)] * 4
    mounts = docker("exec", container, "cat", "/proc/1/mounts").splitlines()
    root = next(line.split() for line in mounts if line.split()[1] == "/")
    assert "ro" in root[3].split(",")


def test_a_follower_s_image_has_no_simulator_and_no_compiler(carry: Carry) -> None:
    code = (
        "import importlib.util as u, shutil; "
        "print([m for m in ('mujoco', 'sim_server', 'pinocchio') if u.find_spec(m)], "
        "[c for c in ('cc', 'gcc', 'g++', 'clang', 'make') if shutil.which(c)])"
    )
    assert docker("exec", carry.container("a1"), "python3", "-c", code) == "['pinocchio'] []"


def test_all_are_healthy(carry: Carry) -> None:
    for service in ("sim", "a1", "a2"):
        wait_until(lambda name=service: carry.look(name)["State"]["Health"]["Status"] == "healthy", service)  # type: ignore[misc]


def test_what_happens_to_a_container_is_what_happens_to_a_process_byte_for_byte(carry: Carry) -> None:
    """Last: it lets the leader in, and the run goes on to its end."""
    place = carry.place
    here = run_to_end("run", "runs/story.toml", "--out", "here", "--no-picture", cwd=place, patience_s=300.0)
    assert "reached its duration" in (place / "here" / "events.jsonl").read_text(), here.stderr
    address = ("--connect", f"tls/localhost:{carry.environment['PALANQUIN_PORT']}")
    operator = ("--engine", "docker", "--credential", "team/operator")
    with started("chaos", "deeds", *operator, *address, cwd=place) as deeds:
        deeds.wait_until(lambda: "does what the scenario" in deeds.said(), "the operator to be connected")
        carry.up("leader")
        status = docker("wait", carry.container("sim"))
        assert deeds.end() == 0, deeds.said()
    there = carry.run
    assert int(status) == here.returncode
    assert read_json(there / "run.json")["ended"]["completed"] is True, deeds.said()

    def told(folder: Path) -> list[tuple[object, ...]]:
        wanted = ("ordered", "seen", "lost")
        return [
            tuple(e.get(what) for what in ("tick", "kind", "event", "agent", "effect", "why", "missed_ticks"))
            for e in read_events(folder)
            if e["kind"] in wanted
        ]

    assert told(there) == told(place / "here")
    assert (there / "trace.parquet").read_bytes() == (place / "here" / "trace.parquet").read_bytes()
