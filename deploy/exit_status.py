"""Exit statuses, and how an error becomes one sentence.

0 the run holds, 1 it violates, 2 bad input, 3 it could not run or cannot be judged. Errors that are raised on purpose
carry their ``exit_status``; what carries none is a bug: its traceback, and
status 3 (Python's own would be 1, a verdict).
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer

BAD_INPUT, COULD_NOT_RUN = 2, 3
OF_VERDICT = {"holds": 0, "violated": 1, "unknown": COULD_NOT_RUN}

EXTRAS = {
    "mujoco": "sim",
    "pyarrow": "sim",
    "pinocchio": "follower",
    "matplotlib": "view",
    "rerun": "view",
    "PIL": "view",
    "av": "view",
}
"""Which extra brings a module that a machine may lack."""


def fail(text: str, status: int) -> NoReturn:
    """Print one sentence and end the verb; a status that is no failure counts as "could not run"."""
    print(f"palanquin: {text}", file=sys.stderr)
    raise typer.Exit(status if status in (BAD_INPUT, COULD_NOT_RUN) else COULD_NOT_RUN)


@contextmanager
def one_sentence() -> Iterator[None]:
    """Turn an error that was raised on purpose, or a missing extra, into one sentence and its exit status."""
    try:
        yield
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        _end(
            f"{error.name} is not installed; expected the extra `{extra}`: pip install 'palanquin[{extra}]'",
            COULD_NOT_RUN,
        )
    except Exception as error:
        status = getattr(error, "exit_status", None)
        if not isinstance(status, int):
            traceback.print_exc()
            _end("this is a bug of Palanquin; please report it with the lines above", COULD_NOT_RUN)
        if getattr(error, "caused_by_user_code", False) and error.__cause__ is not None:
            traceback.print_exception(error.__cause__)  # its author needs to see where
        _end(str(error), status)


def _end(text: str, status: int) -> NoReturn:
    print(f"palanquin: {text}", file=sys.stderr)
    sys.exit(status)
