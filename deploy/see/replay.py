"""A recording for the viewer, made from the trace of a run that was not recorded."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from deploy.see.curves import Start, curves
from deploy.see.happenings import read_happenings
from deploy.see.recording import Recording
from sim_server.looks import shapes
from sim_server.metrics import trace_facts
from sim_server.playback import read_recorded, thinned
from sim_server.run_folder import EVENTS, RunFolderError

SCENE_HZ, CURVES_HZ = 30.0, 50.0
"""Pictures and values a simulated second that a recording has."""


def replay(folder: Path, file: Path) -> None:
    """Write a run's recording, whole or not at all.

    Raises:
        RunFolderError: it is no run folder, or what is in it does not fit.
    """
    run = read_recorded(folder)
    facts, time_s = trace_facts(run.facts), run.trace["time_s"]
    try:
        happenings = list(read_happenings(folder / EVENTS))
    except (OSError, LookupError, ValueError) as error:
        raise RunFolderError(f"{folder / EVENTS} cannot be read: {error}") from None
    part = file.with_name(f"{file.name}.part")
    recording = Recording(f"{run.about['scenario_name']}, seed {run.about['seed']}", file=part)
    recording.scene(shapes(run.playback.world.model), facts.arms, facts.goal_m, run.scenario.load.size_m)
    recording.motion(run.playback.bodies, run.playback.motion(run.trace, thinned(time_s, run.row_s, SCENE_HZ)))
    rows = np.array(thinned(time_s, run.row_s, CURVES_HZ))
    lines = curves(run.trace, facts, Start.of(run.trace))
    recording.curves(
        time_s[rows],
        {question: {name: line[rows] for name, line in named.items()} for question, named in lines.items()},
    )
    for each in happenings:
        recording.happened(each)
    recording.close()
    os.replace(part, file)
