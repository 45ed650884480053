"""Exit statuses, and how an error becomes one sentence.

0 the run holds, 1 it violates, 2 bad input, 3 it could not run or cannot be judged. Errors that are raised on purpose
carry their ``exit_status``; what carries none is a bug: its traceback, and
status 3 (Python's own would be 1, a verdict).
"""

from __future__ import annotations

import errno
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

import typer

BAD_INPUT, COULD_NOT_RUN = 2, 3
OF_VERDICT = {"holds": 0, "violated": 1, "unknown": COULD_NOT_RUN}

EXTRAS = {
    **{"mujoco": "sim", "pyarrow": "sim", "sim_server": "sim"},  # a follower's image has not even our own package
    "pinocchio": "follower",
    **{"matplotlib": "view", "rerun": "view", "PIL": "view", "av": "view"},
}
"""Which extra brings a module that a machine may lack."""


def fail(text: str, status: int) -> NoReturn:
    """Print one sentence and end the verb; a status that is no failure counts as "could not run"."""
    print(f"palanquin: {text}", file=sys.stderr)
    raise typer.Exit(status if status in (BAD_INPUT, COULD_NOT_RUN) else COULD_NOT_RUN)


@contextmanager
def one_sentence() -> Iterator[None]:
    """Turn an error that was raised on purpose, or what a machine lacks, into one sentence and its exit status."""
    try:
        yield
    except BaseException as error:
        meant = _raised_on_purpose(error)
        if meant is not None:
            if getattr(meant, "caused_by_user_code", False) and meant.__cause__ is not None:
                traceback.print_exception(meant.__cause__)  # its author needs to see where
            _end(str(meant), int(getattr(meant, "exit_status", COULD_NOT_RUN)))
        if not isinstance(error, Exception):
            raise  # an exit, with its own status
        if lack := _what_is_lacking(error):
            _end(lack, COULD_NOT_RUN)
        traceback.print_exc()
        _end("this is a bug of Palanquin; please report it with the lines above", COULD_NOT_RUN)


def _raised_on_purpose(error: BaseException) -> BaseException | None:
    """The error itself, if it carries a status; or the signal that a library has made another error of."""
    if isinstance(getattr(error, "exit_status", None), int):
        return error
    behind: BaseException | None = error
    while behind is not None:  # MuJoCo, interrupted while it loads, says that it could not be imported
        if not isinstance(behind, Exception) and isinstance(getattr(behind, "exit_status", None), int):
            return behind
        behind = behind.__cause__ or behind.__context__
    return None


def _what_is_lacking(error: Exception) -> str:
    """What this machine does not have, for errors that mean that and no bug; empty for others."""
    if isinstance(error, ModuleNotFoundError):
        module = (error.name or "").partition(".")[0]
        if extra := EXTRAS.get(module):
            return f"{error.name} is not installed; expected the extra `{extra}`: pip install 'palanquin[{extra}]'"
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        what = f" for {error.filename}" if error.filename else ""
        return f"no space is left on the disk{what}: make room, or choose another place with --out"
    asked = os.environ.get("MUJOCO_GL")
    if asked is not None and any(_is_opengl(frame) for frame, _ in traceback.walk_tb(error.__traceback__)):
        problem = " ".join(f"{type(error).__name__}: {error}".split())
        return (
            f"MUJOCO_GL={asked} cannot be used on this machine ({problem}): unset it, or install what it names "
            "(only `palanquin render` needs OpenGL)"
        )
    return ""


def _is_opengl(frame: FrameType) -> bool:
    """Whether that code loads OpenGL: MuJoCo does so when it is imported, as MUJOCO_GL tells it to."""
    module = str(frame.f_globals.get("__name__", ""))
    return module.startswith(("OpenGL", "mujoco.rendering", "mujoco.gl_context", "mujoco.egl", "mujoco.osmesa"))


def _end(text: str, status: int) -> NoReturn:
    print(f"palanquin: {text}", file=sys.stderr)
    try:
        sys.stdout.flush()
    except OSError:  # it is full: what is left in it goes nowhere, else Python tries again at its end, and says so
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(status)
