"""What goes wrong on a first day: each gets one sentence and the right status, on any terminal."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest
from one_arm import arm
from processes import PALANQUIN, run_to_end
from rich.console import Console

from agents.controllers import make_controller
from deploy.exit_status import COULD_NOT_RUN, one_sentence
from deploy.guard import Interrupted
from deploy.report import print_metrics, print_scenarios
from sim_server.scenario import Bound
from sim_server.scenario_files import load_scenario, shipped_names
from sim_server.verdict import Judged

REPOSITORY = Path(__file__).resolve().parent.parent


def said(capsys: pytest.CaptureFixture[str], error: BaseException) -> str:
    """What the command says of an error that comes out of it; the status is that of what could not run."""
    with pytest.raises(SystemExit) as ended, one_sentence():
        raise error
    assert ended.value.code == COULD_NOT_RUN
    return capsys.readouterr().err


def one_line(text: str, *parts: str) -> None:
    assert text.count("\n") == 1, text
    assert text.startswith("palanquin: ")
    for part in parts:
        assert part in text


# Ctrl-C at any moment.


def test_a_signal_that_a_library_turned_into_its_own_error_is_still_a_signal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def raised_from(cause: BaseException) -> ImportError:
        error = ImportError("initialization failed")
        error.__cause__ = ImportError("within")
        error.__cause__.__context__ = cause
        return error

    one_line(said(capsys, raised_from(Interrupted("SIGINT"))), "stopped by SIGINT")
    assert "bug of Palanquin" in said(capsys, raised_from(ValueError("stopped by SIGINT")))


def test_a_signal_while_a_law_is_made_is_not_taken_for_the_law_s_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "interrupted_law.py").write_text(
        "from deploy.guard import Interrupted\n\n\ndef Law(arm):\n    raise Interrupted('SIGTERM')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(Interrupted):
        make_controller("interrupted_law:Law", arm(), {})


INTERRUPTED_AT = """
import os, signal, sys
from importlib.abc import MetaPathFinder

class Interrupts(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "{module}" and self in sys.meta_path:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)

from deploy.entry import main
sys.meta_path.insert(0, Interrupts())
sys.argv = ["palanquin", "run", "hold", "--out", "never"]
main()
"""


@pytest.mark.parametrize("module", ["mujoco._structs", "pinocchio", "agents.controllers.paper", "llvmlite.binding"])
def test_ctrl_c_while_the_command_gets_going_is_one_sentence(module: str, tmp_path: Path) -> None:
    """At moments at which a library, or a `catch anything`, is between the signal and the end."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_AT.format(module=module)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (3, "", "palanquin: stopped by SIGINT\n")
    assert not (tmp_path / "never").exists()


# A disk that is full.


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_is_no_bug(number: int, capsys: pytest.CaptureFixture[str]) -> None:
    one_line(said(capsys, OSError(number, "full", "runs/a/audit.json")), "no space is left", "runs/a/audit.json")
    one_line(said(capsys, OSError(number, "full")), "no space is left on the disk: make room")
    assert "bug of Palanquin" in said(capsys, OSError(errno.EBADF, "bad descriptor"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux")
def test_an_output_that_is_full_is_one_sentence() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [PALANQUIN, "scenarios"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False
        )
    assert done.returncode == COULD_NOT_RUN
    one_line(done.stderr, "no space is left on the disk")


# No OpenGL, no screen, no such Python.


def test_an_opengl_that_the_environment_asks_for_and_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    done = run_to_end("run", "hold", "--out", "never", cwd=tmp_path, environment={"MUJOCO_GL": "nonsense"})
    assert done.returncode == COULD_NOT_RUN
    one_line(done.stderr, "MUJOCO_GL=nonsense", "unset it")
    assert not (tmp_path / "never").exists()


@pytest.mark.parametrize(
    ("out", "problem"), [("still.jpg", "expected a name that ends in"), ("no/still.png", "there is no folder")]
)
def test_a_picture_that_cannot_be_written_is_refused_before_anything_is_drawn(
    out: str, problem: str, tmp_path: Path
) -> None:
    done = run_to_end("render", "nowhere", "--out", out, cwd=tmp_path)
    assert done.returncode == 2
    one_line(done.stderr, out, problem)


def test_make_says_which_python_it_needs() -> None:
    done = subprocess.run(
        ["make", "python", "PYTHON=/nowhere/python3"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "needs Python 3.11 or newer, and '/nowhere/python3' is not one" in done.stderr
    assert "Traceback" not in done.stderr


# Terminals.


def on_a_terminal(columns: int, *arguments: str, **environment: str) -> tuple[int, str]:
    """Exit status of a command on a terminal of this width, and all that it wrote there."""
    pid, descriptor = pty.fork()
    if pid == 0:
        os.execve(PALANQUIN, ["palanquin", *arguments], {**os.environ, "TERM": "xterm-256color", **environment})
    fcntl.ioctl(descriptor, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    wrote = b""
    while True:
        try:
            part = os.read(descriptor, 65536)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        wrote += part
    os.close(descriptor)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), wrote.decode()


def test_colours_are_for_terminals_that_want_them() -> None:
    status, plain = on_a_terminal(80, "scenarios", NO_COLOR="1")
    assert (status, re.findall(r"\x1b\[[0-9;]*3\dm", plain)) == (0, [])
    lines = re.sub(r"\x1b\[[0-9;]*m", "", plain).splitlines()
    assert max(map(len, lines)) <= 80
    assert "transport-fixed-stiffness" in plain


@pytest.mark.parametrize("columns", [80, 60])
def test_tables_fit_a_narrow_terminal_and_cut_no_name_and_no_number(columns: int) -> None:
    values = {
        "goal_error_m": 0.0166,
        "load_share": {f"a{k}": 0.123456 for k in range(1, 17)},
        "torque_limit_fraction": 0.82,
        "verdict": "violated",
    }
    judged = (Judged("goal_error_m", 0.0166, Bound(max=0.01), "violated"),)
    console = Console(width=columns, record=True, file=io.StringIO(), force_terminal=True)
    print_metrics(console, values, judged)
    print_scenarios(console, [(name, load_scenario(name).scenario.description) for name in shipped_names()])
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= columns
    for word in ("goal_error_m", "0.0166", "torque_limit_fraction", "a16 0.1235", "transport-fixed-stiffness"):
        assert word in " ".join(text.split())
    assert "…" not in text
