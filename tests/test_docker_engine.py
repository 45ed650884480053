"""Deeds to containers where there is no engine, or one that does not obey. Those that are done: test_containers.py.

The engines here are programs of two lines: each answers every command in one way.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from processes import run_to_end

from deploy import docker_engine
from deploy.docker_engine import Docker, EngineError
from wire.messages import Deed

ROOT = Path(__file__).resolve().parent.parent
PINNED = re.compile(r"^(\S+==\S+)", re.MULTILINE)


def engine(folder: Path, line: str) -> Docker:
    program = folder / "docker"
    program.write_text(f"#!/bin/sh\n{line}\n")
    program.chmod(0o755)
    return Docker("carry", str(program))


def test_without_an_engine_a_deed_says_what_is_missing(tmp_path: Path) -> None:
    docker = Docker("carry", str(tmp_path / "nothing"))
    assert "nothing: cannot be run (No such file or directory)" in docker.do(Deed(1, "kill", "a2"))
    with pytest.raises(EngineError, match="install Docker"):
        docker.version()


def test_what_the_engine_says_against_a_deed_comes_back_with_it(tmp_path: Path) -> None:
    docker = engine(tmp_path, "echo first; echo 'permission denied' >&2; exit 1")
    assert docker.do(Deed(1, "stop", "a2")).endswith("ps` failed: permission denied")


@pytest.mark.parametrize(("line", "count"), [(":", 0), ("echo one; echo two", 2)])
def test_a_deed_is_done_to_one_container_or_to_none(tmp_path: Path, line: str, count: int) -> None:
    said = engine(tmp_path, line).do(Deed(1, "kill", "a2"))
    assert said.startswith(f"{count} containers have the labels palanquin.run=carry and palanquin.agent=a2, expected")


def test_a_deed_that_the_engine_only_says_is_done_is_not_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docker_engine, "CONFIRM_S", 0.2)
    said = engine(tmp_path, "echo running").do(Deed(1, "kill", "a2"))
    assert said == "its container is running after 0.2 s, expected exited or dead or created"


def test_who_is_dead_already_cannot_be_stopped(tmp_path: Path) -> None:
    assert engine(tmp_path, "echo exited").do(Deed(1, "stop", "a2")).endswith("not running any more (exited)")


NETWORKED = """
case "$1 $2" in
    "ps --all") echo c2 ;;
    "network disconnect") rm networks/"$3" ;;
    "network connect") touch networks/"$3" ;;
    "inspect --format") case "$3" in *Status*) echo running ;; *) ls networks ;; esac ;;
esac
"""
"""A container in two networks: files of a folder."""


def test_a_container_is_cut_off_from_all_its_networks_and_gets_them_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("team_a2", "team_b"):
        (tmp_path / "networks" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "networks" / name).touch()
    docker = engine(tmp_path, NETWORKED)
    assert docker.do(Deed(1, "disconnect", "a2")) == ""
    assert docker.networks("c2") == []
    assert docker.do(Deed(2, "disconnect", "a2")) == "its container is in no network that it could be cut off from"
    assert docker.do(Deed(3, "reconnect", "a2")) == ""
    assert docker.networks("c2") == ["team_a2", "team_b"]
    stubborn = engine(tmp_path, NETWORKED.replace("rm ", "test -e "))
    assert stubborn.do(Deed(4, "disconnect", "a2")) == "its container is still in team_a2, team_b"


def test_what_is_not_done_to_containers_is_said(tmp_path: Path) -> None:
    assert (
        engine(tmp_path, "echo running").do(Deed(1, "hang", "a2")).startswith("nothing is known that would do 'hang'")
    )


def test_the_verb_ends_in_one_sentence_where_nobody_is(tmp_path: Path) -> None:
    engine(tmp_path, "echo 1.2.3")
    path = {"PATH": f"{tmp_path}:/usr/bin:/bin"}
    waits_for_nobody = ("--connect", "tcp/127.0.0.1:1", "--wait-s", "0")
    done = run_to_end("chaos", "deeds", "--engine", "docker", *waits_for_nobody, cwd=tmp_path, environment=path)
    assert done.returncode == 3
    assert done.stderr.startswith("palanquin: nobody answers at tcp/127.0.0.1:1")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("role", ["follower", "sim"])
def test_an_image_installs_the_versions_that_were_tested(role: str) -> None:
    """The lock of a role is a part of the whole one; else an image would run what no test has seen."""
    whole = set(PINNED.findall((ROOT / "requirements.lock").read_text(encoding="utf-8")))
    part = set(PINNED.findall((ROOT / f"deploy/requirements-{role}.lock").read_text(encoding="utf-8")))
    assert part <= whole
    names = {pin.partition("==")[0] for pin in part}
    assert ("mujoco" in names, "pin" in names) == ((False, True) if role == "follower" else (True, False))
