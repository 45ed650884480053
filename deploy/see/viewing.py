"""``palanquin view``: the viewer's own process, and what it opens."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from deploy.exit_status import BAD_INPUT, COULD_NOT_RUN, fail
from sim_server.run_folder import read_run

RECORDING = "run.rrd"
"""A run's recording, in its folder."""


def save_recording(folder: Path, file: Path) -> None:
    """Write a recording of a run, made of its trace.

    Raises:
        RunFolderError: it is no run folder.
    """
    if not file.absolute().parent.is_dir():
        fail(f"--save {file}: there is no folder {file.absolute().parent}", BAD_INPUT)
    from deploy.see.replay import replay

    replay(folder, file)


def view_run(folder: Path) -> None:
    """Open the viewer and wait until it is closed.

    Raises:
        RunFolderError: it is no run folder.
    """
    read_run(folder)
    command = viewer_command()
    recorded = folder / RECORDING
    if recorded.exists():
        _show(command, recorded)
        return
    with tempfile.TemporaryDirectory(prefix="palanquin-") as made:
        file = Path(made) / RECORDING
        save_recording(folder, file)
        _show(command, file)


def viewer_command() -> list[str]:
    """How the viewer is started. Ends the verb with one sentence where it cannot be."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        fail(
            "there is no screen for the viewer (neither DISPLAY nor WAYLAND_DISPLAY is set): write the recording with "
            "`palanquin view RUN --save FILE` or `palanquin run --record`, and open it with `rerun FILE` on a machine "
            "that has one",
            COULD_NOT_RUN,
        )
    # Not the script `rerun`: it stands between us and the viewer, and to end it leaves the viewer running.
    found = importlib.util.find_spec("rerun_cli")
    places = list(found.submodule_search_locations or []) if found else []
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    binary = next((Path(place) / name for place in places if (Path(place) / name).is_file()), None)
    if binary is None:
        raise ModuleNotFoundError("the viewer's program is not there", name="rerun")
    return [str(binary)]


def _show(command: list[str], file: Path) -> None:
    status = subprocess.run([*command, str(file)], check=False).returncode
    if status:
        fail(f"the viewer ended with status {status}; what it said is above", COULD_NOT_RUN)
