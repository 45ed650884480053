"""``palanquin render``: a still of a run, from its trace."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NoReturn

from deploy.exit_status import BAD_INPUT, fail

HEADLESS = "egl"
"""What renders without a screen where nothing else is asked for."""


def render_still(folder: Path, time_s: float, file: Path) -> None:
    """Write a PNG of a run at a moment. Before MuJoCo is loaded in this process. A file that cannot be ends the verb.

    Raises:
        sim_server.run_folder.RunFolderError: it is no run folder.
        sim_server.stills.CannotRender: there is no library for off-screen OpenGL.
    """
    if file.suffix.lower() != ".png" or not file.parent.is_dir():
        _cannot_write(file, "another kind of file" if file.parent.is_dir() else "no such folder")
    os.environ.setdefault("MUJOCO_GL", HEADLESS)
    from sim_server.stills import draw_still

    picture = draw_still(folder, time_s)
    import matplotlib.image

    try:
        matplotlib.image.imsave(file, picture)
    except OSError as error:
        _cannot_write(file, str(error.strerror))


def _cannot_write(file: Path, problem: str) -> NoReturn:
    fail(f"{file}: no picture can be written there ({problem}); expected a .png in a folder that is there", BAD_INPUT)
