"""The picture of a run: path, height, roll/pitch/yaw and grip forces over time. Needs the extra ``view``."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # before pyplot: no display needed

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from sim_server.metrics import roll_pitch_yaw_deg, rotation_matrices
from sim_server.run_folder import TRACE, read_run
from sim_server.trace import read_trace

PICTURE = "run.png"
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#999933", "#595959")
"""Okabe and Ito's colours, told apart by colour-blind people too; arm a1 has the first."""

Trace = dict[str, NDArray[np.float64]]


def draw_run(folder: Path) -> Path:
    """Draw a run folder's picture into it and return the file.

    Raises:
        sim_server.run_folder.RunFolderError: it is no run folder.
    """
    run = read_run(folder)
    facts, size = run["facts"], run["scenario"]["load"]["size_m"]
    trace = dict(read_trace(folder / TRACE))
    figure, axes = plt.subplots(2, 2, figsize=(12, 8), layout="constrained")
    _path(axes[0, 0], trace, facts, size)
    _height(axes[0, 1], trace)
    _attitude(axes[1, 0], trace)
    _grips(axes[1, 1], trace, facts["arms"])
    for axis in (axes[0, 1], axes[1, 0], axes[1, 1]):
        _shade(axis, trace, facts["arms"])
    figure.suptitle(f"{run['scenario_name']}, seed {run['seed']}: {run['scenario']['description']}", fontsize=10)
    file = folder / PICTURE
    figure.savefig(file, dpi=110)
    plt.close(figure)
    return file


def _path(axes: Axes, trace: Trace, facts: dict[str, object], size: list[float]) -> None:
    """Top view: the load's path, its outline at the start and the end, the bases' paths, the goal."""
    position = trace["load.position"]
    R = rotation_matrices(trace["load.quat_wxyz"])
    corners = 0.5 * np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]]) * np.array(size)
    for index, style in ((0, ":"), (-1, "-")):
        outline = position[index] + corners @ R[index].T
        axes.add_patch(Polygon(outline[:, :2], fill=False, linestyle=style, edgecolor="#444444"))
    for k, arm in enumerate(_arms(facts)):
        base = trace[f"{arm}.base"]
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(base[:, 0], base[:, 1], color=colour, linewidth=1, label=f"base {arm}")
        axes.plot(*base[-1, :2], "s", color=colour, markersize=6)
    axes.plot(position[:, 0], position[:, 1], color="black", linewidth=2, label="load")
    goal = facts["goal_m"]
    if isinstance(goal, list):
        axes.plot(*goal, "x", color="red", markersize=11, markeredgewidth=3, label="goal")
    axes.set(title="Path from above (outline: start dotted, end solid)", xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_adjustable("datalim")
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=7)
    axes.grid(alpha=0.3)


def _shade(axes: Axes, trace: Trace, arms: list[str]) -> None:
    """Grey where something disturbed the load or a hand."""
    parts = [trace[name] for name in ("load.disturbance", *(f"{arm}.disturbance" for arm in arms)) if name in trace]
    disturbed = np.any([np.nan_to_num(part).any(axis=1) for part in parts], axis=0)
    if np.any(disturbed):
        across = axes.get_xaxis_transform()
        axes.fill_between(trace["time_s"], 0.0, 1.0, where=disturbed, transform=across, color="#000000", alpha=0.08)


def _arms(facts: dict[str, object]) -> list[str]:
    arms = facts["arms"]
    return [str(arm) for arm in arms] if isinstance(arms, list) else []


def _height(axes: Axes, trace: Trace) -> None:
    height_mm = 1e3 * (trace["load.position"][:, 2] - trace["load.position"][0, 2])
    axes.plot(trace["time_s"], height_mm, color="black")
    axes.set(title="Height of the load against its start", xlabel="time [s]", ylabel="[mm]")
    axes.grid(alpha=0.3)


def _attitude(axes: Axes, trace: Trace) -> None:
    angles = roll_pitch_yaw_deg(trace["load.quat_wxyz"])
    for column, name, colour in ((0, "roll", COLOURS[0]), (1, "pitch", COLOURS[1])):
        axes.plot(trace["time_s"], angles[:, column], color=colour, label=name)
    axes.set(title="Roll and pitch (left), yaw (right) of the load", xlabel="time [s]", ylabel="roll, pitch [deg]")
    right = axes.twinx()
    right.plot(trace["time_s"], angles[:, 2], color=COLOURS[2], linestyle="--", label="yaw")
    right.set_ylabel("yaw [deg]")
    lines = [*axes.get_lines(), *right.get_lines()]
    axes.legend(lines, [str(line.get_label()) for line in lines], fontsize=8)
    axes.grid(alpha=0.3)


def _grips(axes: Axes, trace: Trace, arms: list[str]) -> None:
    for k, arm in enumerate(arms):
        grip = trace[f"{arm}.grip"]
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(trace["time_s"], grip[:, 2], color=colour, label=f"{arm} up")
        axes.plot(trace["time_s"], np.hypot(grip[:, 0], grip[:, 1]), color=colour, linewidth=0.8, linestyle=":")
    axes.set(title="Grip forces: up (solid), in the plane (dotted)", xlabel="time [s]", ylabel="[N]")
    axes.legend(fontsize=7, ncols=2)
    axes.grid(alpha=0.3)
