"""``palanquin run --watch``: the dashboard of a launched run, an observer's process of its own in the same terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from deploy.launcher import child_environment
from sim_server.faults.processes import SimKill
from sim_server.scenario_files import NamedScenario
from wire.access import Role
from wire.credentials import STDIN, Guests, credential_line

ENDED_S = 5.0
"""Wall time that it gets to leave the terminal after the simulator has gone, and again after it was told to."""
TERMINAL_AS_IT_WAS = "\x1b[?1049l\x1b[?25h"
"""The first screen and its cursor again: for a dashboard that could not see to it itself."""


@contextmanager
def dashboard_beside(
    endpoint: str, run: str, guests: Guests, named: NamedScenario, scenario_arguments: Sequence[str], log: Path
) -> Iterator[None]:
    """A dashboard that is there before the simulator, so that it misses nothing, and ends with it.

    Args:
        endpoint: where the simulator will listen.
        run: name of the run.
        guests: credentials of everybody; it is handed the observer's over its standard input.
        named: the scenario.
        scenario_arguments: how the scenario is found (changes, ``--``, file or name).
        log: where its errors go at the end, if the folder is there by then.
    """
    patience = repr(named.scenario.clock.start_timeout_s)
    comes_back = any(isinstance(event, SimKill) for event in named.scenario.events)
    arguments = ["watch", "--run", run, "--connect", endpoint, "--credential", STDIN, "--with-parent"]
    arguments += ["--wait-s", patience, "--reconnect-s", patience if comes_back else "0", *scenario_arguments]
    with tempfile.TemporaryFile() as errors:  # on the terminal they would stand in the picture
        process = subprocess.Popen(
            [sys.executable, "-m", "deploy.cli", *arguments],
            stdin=subprocess.PIPE,
            stderr=errors,
            start_new_session=True,  # a Ctrl-C ends the run, and then the dashboard
            env=child_environment(os.environ),
        )
        assert process.stdin is not None
        with suppress(BrokenPipeError):
            process.stdin.write(credential_line(guests.of(Role.OBSERVER)))
            process.stdin.flush()
        try:
            yield
        except BaseException:
            process.terminate()
            raise
        finally:
            _end(process)
            errors.seek(0)
            if (said := errors.read()) and log.parent.is_dir():
                log.write_bytes(said)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Wait until it has left the terminal, or make it."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(subprocess.TimeoutExpired):
            process.wait(ENDED_S)
        if process.poll() is None:
            process.send_signal(number)
    if process.wait() < 0:
        sys.stdout.write(TERMINAL_AS_IT_WAS)
    if process.stdin is not None:
        with suppress(BrokenPipeError):
            process.stdin.close()
