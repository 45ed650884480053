"""A console for whoever may go away."""

from __future__ import annotations

import os
import sys

from rich.console import Console

from deploy.exit_status import COULD_NOT_RUN


class PatientConsole(Console):
    """A console whose reader may go away (``| head``): the run ends, and not with the status of a verdict."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(COULD_NOT_RUN)
