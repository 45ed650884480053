"""Rooms of agents: gone with their launcher, and swept by the next one if that was killed."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import processes_that_name, run_to_end

from deploy.room import PREFIX, Rooms, sweep

HOLDS_A_ROOM = """
import sys
from deploy.room import Rooms
print(Rooms().make(), flush=True)
sys.stdin.read()
"""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    yield tmp_path
    tempfile.tempdir = None


def test_rooms_are_gone_with_what_is_in_them(temporary: Path) -> None:
    rooms = Rooms()
    first, second = rooms.make(), rooms.make()
    (first / "left").write_text("something")
    rooms.clear()
    assert not first.exists()
    assert not second.exists()


def test_a_room_of_a_launcher_that_lives_is_left_and_one_of_a_killed_launcher_is_swept(temporary: Path) -> None:
    other = subprocess.Popen(
        [sys.executable, "-c", HOLDS_A_ROOM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    room = Path(other.stdout.readline().strip())
    try:
        sweep()
        assert room.exists()
    finally:
        other.kill()
        other.wait()
    sweep()
    assert not room.exists()


FORKS = """
import os, time
from agents.controllers.paper import PaperController

class Forks(PaperController):
    def __init__(self, arm):
        super().__init__(arm)
        self.begun = False

    def step(self, sensed, dt_s):
        if not self.begun:
            self.begun = True
            if os.fork() == 0:
                time.sleep(600)
        return super().step(sensed, dt_s)
"""


@pytest.mark.system
def test_what_a_law_has_started_goes_with_its_run(tmp_path: Path) -> None:
    law = f"forking_{os.getpid()}_{secrets.token_hex(4)}"  # nobody else's on this machine
    (tmp_path / f"{law}.py").write_text(FORKS)
    values = ("--set", "duration_s=0.1", "--set", f'team.controller="{law}:Forks"', "--no-picture")
    done = run_to_end("run", "hold", "--out", "run", *values, cwd=tmp_path)
    assert (tmp_path / "run" / "trace.parquet").exists(), done.stderr
    assert processes_that_name(law) == []


def test_what_is_not_an_empty_room_is_never_swept(temporary: Path) -> None:
    full, other, file = temporary / f"{PREFIX}full", temporary / "palanquin-world-x", temporary / f"{PREFIX}file"
    for folder in (full, other):
        folder.mkdir()
    (full / "somebody's").write_text("own")
    file.write_text("a file")
    sweep()
    assert full.exists()
    assert other.exists()
    assert file.exists()
