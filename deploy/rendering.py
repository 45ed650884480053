"""``palanquin render``: a still of a run, from its trace."""

from __future__ import annotations

import os
from pathlib import Path

HEADLESS = "egl"
"""What renders without a screen where nothing else is asked for."""


def render_still(folder: Path, time_s: float, file: Path) -> None:
    """Write a PNG of a run at a moment. Before MuJoCo is loaded in this process.

    Raises:
        sim_server.run_folder.RunFolderError: it is no run folder.
        sim_server.stills.CannotRender: there is no library for off-screen OpenGL.
    """
    os.environ.setdefault("MUJOCO_GL", HEADLESS)
    from sim_server.stills import draw_still

    picture = draw_still(folder, time_s)
    import matplotlib.image

    matplotlib.image.imsave(file, picture)
