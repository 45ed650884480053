"""Whoever ends the command while its modules load gets one sentence and the status of what could not run."""

from __future__ import annotations

import subprocess
import sys

import pytest

from deploy import entry, exit_status

INTERRUPTED_WHILE_LOADING = """
import os, signal, sys

class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "deploy.cli":
            os.kill(os.getpid(), signal.{signal})

sys.meta_path.insert(0, Interrupts())
from deploy.entry import main
main()
"""


@pytest.mark.parametrize("signal", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_who_is_stopped_while_loading_says_so_in_one_sentence(signal: str) -> None:
    code = INTERRUPTED_WHILE_LOADING.format(signal=signal)
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "", f"palanquin: stopped by {signal}\n")


def test_its_status_is_that_of_what_could_not_run() -> None:
    assert entry.COULD_NOT_RUN == exit_status.COULD_NOT_RUN
