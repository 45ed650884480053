"""The process that reads a keyboard or a gamepad: what it says, and the terminal as it was after every ending."""

from __future__ import annotations

import importlib.util
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from processes import run_to_end, wait_until
from terminals import Terminal, typed_into

from agents.wish import Wish
from deploy.person.attending import attended

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]


class Reader:
    """That process, at a terminal, and who hears it."""

    def __init__(self) -> None:
        self.terminal = Terminal()
        self.line, theirs = socket.socketpair()
        command = [sys.executable, "-m", "deploy.person", "keyboard"]
        with theirs:
            self.process = subprocess.Popen(command, stdin=self.terminal.theirs, stdout=theirs.fileno())
        self.heard = self.line.makefile("rb")
        assert self.heard.readline() == b"ready\n"

    def wish(self) -> Wish:
        self.line.settimeout(60.0)
        return Wish.read(self.heard.readline().rstrip(b"\n"))


@pytest.fixture
def reader() -> Iterator[Reader]:
    reader = Reader()
    try:
        yield reader
    finally:
        reader.process.kill()
        reader.process.wait(10)
        reader.line.close()
        reader.terminal.close()


def test_each_key_is_heard_at_once_and_none_is_shown(reader: Reader) -> None:
    assert reader.terminal.gives_each_key
    reader.terminal.type(b"\x1b[A")
    assert reader.wish() == Wish((0.5, 0.0))
    reader.terminal.type(b"+d")
    assert [reader.wish(), reader.wish()] == [Wish((0.6, 0.0)), Wish((0.0, -0.6))]
    reader.terminal.type(b"\x1a ")  # Ctrl-Z is no key of ours, and stops nobody
    assert reader.wish() == Wish()
    assert reader.terminal.shown() == ""


def hang_up(reader: Reader) -> None:
    reader.line.shutdown(socket.SHUT_RDWR)


ENDINGS: dict[str, Callable[[Reader], object]] = {
    "the person leaves": lambda reader: reader.terminal.type(b"q"),
    "SIGTERM": lambda reader: reader.process.send_signal(signal.SIGTERM),
    "SIGHUP": lambda reader: reader.process.send_signal(signal.SIGHUP),
    "nobody listens any more, as when the leader is killed": hang_up,
}


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_terminal_is_as_before_after(ending: str, reader: Reader) -> None:
    assert not reader.terminal.is_as_before
    ENDINGS[ending](reader)
    assert reader.process.wait(60) == 0
    assert reader.terminal.is_as_before


def test_ctrl_c_is_for_the_leader_and_not_for_it(reader: Reader) -> None:
    reader.process.send_signal(signal.SIGINT)
    reader.terminal.type(b"w")
    assert reader.wish() == Wish((0.5, 0.0))


def test_it_ends_with_its_terminal(reader: Reader) -> None:
    reader.terminal.close()
    assert reader.process.wait(60) == 0


# What is not there is one sentence.


@pytest.mark.parametrize(
    "words",
    [("leader", "--run", "x", "--keyboard"), ("run", "transport-real-time", "--leader", "keyboard", "--out", "out")],
)
def test_without_a_terminal_there_is_no_keyboard(words: tuple[str, ...], tmp_path: Path) -> None:
    ended = run_to_end(*words, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert line == "palanquin: --keyboard: standard input is no terminal; expected one, whose keys lead"
    assert ended.returncode == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(Path("/dev/input").exists(), reason="this machine may have a gamepad")
def test_without_a_gamepad_or_what_reads_it_there_is_none(tmp_path: Path) -> None:
    ended = run_to_end("leader", "--run", "x", "--gamepad", cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    there = importlib.util.find_spec("pygame") is not None
    assert ("no gamepad is there" if there else "expected the extra `gamepad`: pip install") in line
    assert ended.returncode == 2


VIRTUAL_GAMEPAD = """
import ctypes, sys
from deploy.person import gamepad
looks = None

def play(name, *arguments):
    getattr(sdl, name)(*arguments)
    return [wish for wish in (next(looks) for _ in range(3)) if wish]

import os
os.environ["SDL_VIDEODRIVER"] = "dummy"
import pygame
pygame.display.init()
pygame.joystick.init()
sdl = ctypes.CDLL(next(line.split()[-1] for line in open("/proc/self/maps") if "libSDL2-2" in line))
number = sdl.SDL_JoystickAttachVirtual(1, 2, 2, 0)
sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
pad = ctypes.c_void_p(sdl.SDL_JoystickOpen(number))
axis = lambda which, to: play("SDL_JoystickSetVirtualAxis", pad, which, ctypes.c_int16(to))
button = lambda which, to: play("SDL_JoystickSetVirtualButton", pad, which, ctypes.c_uint8(to))
looks = gamepad.wishes()
assert next(looks) is None
print(axis(1, -32768), axis(1, 0), axis(0, 32767), axis(0, 3000), button(0, 1), button(0, 0), button(1, 1), sep="\\n")
sdl.SDL_JoystickDetachVirtual(number)
print(list(looks))
"""


@pytest.mark.skipif(importlib.util.find_spec("pygame") is None, reason="needs the extra gamepad")
@pytest.mark.skipif(sys.platform != "linux", reason="finds SDL in /proc")
def test_a_gamepad_of_sdl_s_own_pulls_brakes_leaves_and_ends_when_it_is_unplugged(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", VIRTUAL_GAMEPAD], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    said = [line for line in done.stdout.splitlines() if not line.startswith("pygame")]
    assert said == [
        str([Wish((1.0, 0.0))]),
        str([Wish()]),
        str([Wish((0.0, -1.0))]),
        str([Wish()]),
        str([Wish(brake=True)]),
        str([Wish()]),
        str([Wish(leave=True)]),
        "[]",
    ], done.stderr


def test_who_hangs_up_waits_until_the_terminal_is_as_before(tmp_path: Path) -> None:
    script = (
        "import queue\n"
        "from deploy.person.attending import attended\n"
        "heard = queue.SimpleQueue()\n"
        "with attended('keyboard') as person:\n"
        "    person.hand_on(heard.put, lambda: heard.put(b'gone'))\n"
        "    print('attended', flush=True)\n"
        "    print(heard.get(), flush=True)\n"
        "print('over', heard.empty(), flush=True)\n"
        "input()\n"
    )
    with typed_into([sys.executable, "-c", script], tmp_path) as (terminal, process):
        terminal.wait_for("attended")
        assert terminal.gives_each_key
        terminal.type(b"4")
        terminal.wait_for("over True")
        assert terminal.is_as_before
        terminal.type(b"\n")
        wait_until(lambda: process.poll() is not None, "its end")


def test_attending_is_said_to_be_impossible_in_this_process_too() -> None:
    with pytest.raises(Exception, match="standard input is no terminal") as caught, attended("keyboard"):
        pass
    assert getattr(caught.value, "exit_status", None) == 2
