"""A ``palanquin`` command that is refused before anything starts: in this process, since a new one takes a second."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from typer.testing import CliRunner

from deploy.cli import app


def refused(arguments: Sequence[str | Path]) -> tuple[int, str]:
    """Its exit status and what it says. How an error becomes a sentence, and one only, is the entry's business."""
    done = CliRunner().invoke(app, [str(word) for word in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        return int(getattr(done.exception, "exit_status", 3)), str(done.exception)
    return done.exit_code, done.stderr.strip()
