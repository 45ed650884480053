"""The command's first moments: whoever ends it while its modules load gets one sentence, not a traceback.

Nothing has been started then and nothing written, so there is nothing to clean up.
"""

from __future__ import annotations

import os
import signal
from types import FrameType

COULD_NOT_RUN = 3
"""As in deploy/exit_status.py, which is not loaded yet."""


def main() -> None:
    """Entry point of ``palanquin``."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _end)
    from deploy.cli import main as command

    command()


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, f"palanquin: stopped by {signal.Signals(number).name}\n".encode())
    os._exit(COULD_NOT_RUN)
