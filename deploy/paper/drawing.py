"""Which figures there are runs for, and what each of them shows."""

from __future__ import annotations

import logging
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from deploy.paper import figures
from deploy.paper.ablations import ABLATIONS, SWEEPS
from deploy.paper.figures import Shown, Swept
from deploy.paper.judging import TRAJECTORY, disturbed_s, wanted_height
from deploy.paper.plan import SECTION_VI
from deploy.paper.report import COMPARED, swept
from deploy.paper.results import Results, hand_places

log = logging.getLogger("palanquin.paper")

LAWS = ("paper", "palanquin")
"""The laws whose claims are judged and drawn."""
CURVES = ("tilt_max_deg", "sag_max_mm", "goal_error_m", "arrival_time_s", "internal_force_rms_N", "torque_rms_Nm")
"""Metrics of the ablations' figure."""


def draw(results: Results, out: Path) -> dict[str, str]:
    """The figures that there are runs for: file by title."""
    drawn: dict[str, str] = {}
    for law in LAWS:
        if all(results.seeds("VI-A", condition.name, law) for condition in SECTION_VI["VI-A"]):
            file = f"paper-fig4-{law}.png"
            _figure_4(results, law, out / file)
            drawn[f"Fig. 4, law `{law}`: selective control of the hand"] = file
    if results.seeds(*TRAJECTORY, "fixed") and results.seeds(*TRAJECTORY, "paper"):
        _figure_5(results, out / "paper-fig5.png")
        drawn["Fig. 5: a trajectory with an unknown load, without and with dynamic stiffness"] = "paper-fig5.png"
    for law in LAWS:
        if results.seeds("VI-C", "undisturbed", law):
            file = f"paper-fig6-{law}.png"
            _figure_6(results, law, out / file)
            drawn[f"Fig. 6, law `{law}`: four arms carry a 20 kg table (bands: 90 % of the seeds)"] = file
    return drawn


def draw_ablations(results: Results, file: Path) -> bool:
    """Draw those whose values are numbers, if any was run."""
    rows = []
    for ablation in ABLATIONS:
        numbers = [number for value in ablation.values if (number := _number(value)) is not None]
        laws = [law for law in ablation.presets if any(results.seeds(ablation.name, v, law) for v in ablation.values)]
        if len(numbers) == len(ablation.values) > 1 and laws:
            metrics: dict[str, dict[str, list[float | None]]] = {}
            for metric, heading in COMPARED:
                if metric in CURVES:
                    metrics[heading] = {}
                    for law in laws:
                        found = [results.spread(metric, ablation.name, value, law) for value in ablation.values]
                        metrics[heading][law] = [each.median if each else None for each in found]
            rows.append(Swept(ablation.label, numbers, metrics))
    if rows:
        figures.figure_ablations(rows, file)
    return bool(rows)


def draw_sweeps(results: Results, file: Path) -> bool:
    """Draw the sweeps of the trajectory, if any was run."""
    rows = []
    for sweep in SWEEPS:
        metrics: dict[str, dict[str, list[float | None]]] = {}
        for law in sweep.presets:
            for value in sweep.values:
                for heading, found in swept(results, sweep.name, value, law).items():
                    metrics.setdefault(heading, {}).setdefault(law, []).append(found.median if found else None)
        if any(y is not None for laws in metrics.values() for found in laws.values() for y in found):
            rows.append(Swept(sweep.label, [float(value) for value in sweep.values], metrics))
    if rows:
        figures.figure_ablations(rows, file)
    return bool(rows)


def _number(value: str) -> float | None:
    """A value's number: of ``x3`` it is 3."""
    try:
        return float(value.removeprefix("x"))
    except ValueError:
        return None


def _figure_4(results: Results, law: str, file: Path) -> None:
    rows = []
    for condition in SECTION_VI["VI-A"]:
        trace = results.trace(results.run("VI-A", condition.name, law, results.seeds("VI-A", condition.name, law)[0]))
        rows.append((condition.label, trace, hand_places(trace)))
    figures.figure_4(rows, file)


def _figure_5(results: Results, file: Path) -> None:
    columns = []
    for law, title in (("fixed", "fixed stiffness"), ("paper", "dynamic stiffness")):
        run = results.run(*TRAJECTORY, law, results.seeds(*TRAJECTORY, law)[0])
        trace = results.trace(run)
        height = hand_places(trace)[:, 2]
        columns.append((title, trace, height, height[0] + wanted_height(results.about(run), trace["time_s"])))
    figures.figure_5(columns, file)


def _figure_6(results: Results, law: str, file: Path) -> None:
    shown = []
    for condition in SECTION_VI["VI-C"]:
        seeds = results.seeds("VI-C", condition.name, law)
        if not seeds:
            continue
        runs = [results.run("VI-C", condition.name, law, seed) for seed in seeds]
        about = results.about(runs[0])
        goal = about["facts"]["goal_m"]
        shown.append(
            Shown(condition.label, [results.trace(run) for run in runs], disturbed_s(about), (goal[0], goal[1]))
        )
    figures.figure_6(shown, shown, _pictures(results, law), file)


def _pictures(results: Results, law: str) -> list[np.ndarray]:
    """The start and the end of the first carry, rendered; nothing on a machine that cannot.

    By processes of their own: what renders has to be chosen before MuJoCo is loaded, and it is loaded here.
    """
    seed = results.seeds("VI-C", "undisturbed", law)[0]
    run = results.run("VI-C", "undisturbed", law, seed)
    pictures = []
    with tempfile.TemporaryDirectory() as room:
        for time_s in (0.0, float(results.trace(run)["time_s"][-1])):
            file = Path(room) / "still.png"
            command = [sys.executable, "-m", "deploy.cli", "render", str(results.folder(run)), "--out", str(file)]
            ended = subprocess.run([*command, "--time-s", str(time_s)], capture_output=True, text=True, check=False)
            if ended.returncode:
                log.warning("no pictures of the carry: %s", ended.stderr.strip())
                return []
            pictures.append(plt.imread(file))
    return pictures
