"""Figures 4, 5 and 6 in the paper's arrangement, from traces. Needs the extra ``view``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # before pyplot: no display needed

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from deploy.picture import COLOURS
from sim_server.metrics import roll_pitch_yaw_deg, tilt_deg

Array = NDArray[np.float64]
Trace = Mapping[str, Array]

XYZ = ("x", "y", "z")
DPI = 120
WIDE = 20.0
"""Largest over smallest number from which an axis of an ablation is logarithmic."""


@dataclass(frozen=True, slots=True)
class Shown:
    """One condition as a figure shows it."""

    label: str
    traces: Sequence[Trace]
    """Of all seeds; the first is drawn, the others give the band."""
    shaded_s: tuple[float, float] | None = None
    """When the disturbance acts."""
    goal_m: tuple[float, float] | None = None


def figure_4(rows: Sequence[tuple[str, Trace, Array]], file: Path) -> None:
    """Forces on the hand left, its pose right; a row per kind of force.

    Args:
        rows: title, trace, and the hand's places, (rows, 3) m, of each.
    """
    figure, axes = plt.subplots(len(rows), 2, figsize=(11, 3.4 * len(rows)), layout="constrained", squeeze=False)
    for (title, trace, hand), (left, right) in zip(rows, axes, strict=True):
        time_s, force = trace["time_s"], trace["a1.disturbance"][:, :3]
        for k, name in enumerate(XYZ):
            left.plot(time_s, force[:, k], color=COLOURS[k], linewidth=1, label=f"F{name}")
            right.plot(time_s, 1e3 * (hand[:, k] - hand[0, k]), color=COLOURS[k], linewidth=1, label=name)
        _dress(left, f"Forces on the hand: {title}", "[N]")
        _dress(right, "Pose of the hand against its start", "x, y, z [mm]")
        _angles(right, trace)
    _save(figure, file)


def _angles(axes: Axes, trace: Trace) -> None:
    angles = roll_pitch_yaw_deg(trace["load.quat_wxyz"])
    beside = axes.twinx()
    for k, name in enumerate(("roll", "pitch")):
        beside.plot(trace["time_s"], angles[:, k], color=COLOURS[3 + k], linestyle="--", linewidth=1, label=name)
    largest = max(1.0, 1.2 * float(np.abs(angles[:, :2]).max()))
    beside.set_ylim(-largest, largest)
    beside.set_ylabel("roll, pitch [deg]")
    lines = [*axes.get_lines(), *beside.get_lines()]
    axes.legend(lines, [str(line.get_label()) for line in lines], fontsize=7, ncols=5, loc="upper right")


def figure_5(columns: Sequence[tuple[str, Trace, Array, Array]], file: Path) -> None:
    """(A) The wanted height dotted, the hand's solid; (B) the joints' torques. Left without, right with dynamic
    stiffness.

    Args:
        columns: title, trace, the hand's height and the wanted one, (rows,) m, of each.
    """
    figure, axes = plt.subplots(2, len(columns), figsize=(5.5 * len(columns), 6.4), layout="constrained", sharey="row")
    for k, (title, trace, height, wanted) in enumerate(columns):
        time_s = trace["time_s"]
        above, below = axes[0, k], axes[1, k]
        above.plot(time_s, 1e3 * (wanted - wanted[0]), color="black", linestyle=":", label="desired")
        above.plot(time_s, 1e3 * (height - wanted[0]), color=COLOURS[0], label="hand")
        _dress(above, f"(A) {title}", "height [mm]")
        for joint, torque in enumerate(trace["a1.tau"].T):
            below.plot(time_s, torque, color=COLOURS[joint % len(COLOURS)], linewidth=1, label=f"joint {joint + 1}")
        _dress(below, "(B) joint torques", "[N m]")
        above.legend(fontsize=7)
        below.legend(fontsize=7, ncols=4)
    _save(figure, file)


def figure_6(panels: Sequence[Shown], closer: Sequence[Shown], pictures: Sequence[Array], file: Path) -> None:
    """Top: start and end of a carry. Below: the load's centre over time, a panel a condition, disturbances shaded.
    Last, bottom right as in the paper: the rotations out of the plane of all conditions in one axis.

    Args:
        pictures: (height, width, 3) of the start and the end; empty if none could be rendered.
    """
    rows = len(panels) // 2 + 1
    figure = plt.figure(figsize=(11, 3.2 * (rows + bool(pictures))), layout="constrained")
    grid = figure.add_gridspec(rows + bool(pictures), 2)
    for k, picture in enumerate(pictures[:2]):
        axes = figure.add_subplot(grid[0, k])
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(("start", "end")[k], fontsize=9)
    for k, shown in enumerate(panels):
        _centre(figure.add_subplot(grid[bool(pictures) + k // 2, k % 2]), shown)
    _rotations(figure.add_subplot(grid[-1, 1] if len(panels) % 2 else grid[-1, :]), closer)
    _save(figure, file)


def _centre(axes: Axes, shown: Shown) -> None:
    first = shown.traces[0]
    for k, name in enumerate(XYZ):
        start = first["load.position"][0, k] if k == 2 else 0.0
        _band(axes, first["time_s"], [trace["load.position"][:, k] - start for trace in shown.traces], COLOURS[k])
        axes.plot(first["time_s"], first["load.position"][:, k] - start, color=COLOURS[k], label=name)
    if shown.goal_m:
        axes.axhline(shown.goal_m[0], color="red", linestyle="--", linewidth=0.8, label="goal (x)")
    _shade(axes, shown.shaded_s)
    _dress(axes, f"Centre of the load: {shown.label}", "[m]")
    axes.legend(fontsize=7, ncols=4)


def _rotations(axes: Axes, closer: Sequence[Shown]) -> None:
    for k, shown in enumerate(closer):
        first = shown.traces[0]
        _band(axes, first["time_s"], [tilt_deg(trace["load.quat_wxyz"]) for trace in shown.traces], COLOURS[k])
        style = ("-", "--", "-.", (0, (5, 1)), ":")[k % 5]
        axes.plot(
            first["time_s"], tilt_deg(first["load.quat_wxyz"]), color=COLOURS[k], linestyle=style, label=shown.label
        )
    _dress(axes, "Rotation out of the plane, all conditions", "tilt [deg]")
    axes.legend(fontsize=7, ncols=3)


@dataclass(frozen=True, slots=True)
class Swept:
    """One ablation as the figure of all of them shows it: a row."""

    label: str
    values: Sequence[float]
    metrics: Mapping[str, Mapping[str, Sequence[float | None]]]
    """By the metric's heading and the law: a number for each value, None where there is none."""


def figure_ablations(rows: Sequence[Swept], file: Path) -> None:
    """How metrics go with what is changed: a row per ablation, a column per metric, a line per law."""
    metrics = list(rows[0].metrics)
    figure, axes = plt.subplots(
        len(rows), len(metrics), figsize=(3.2 * len(metrics), 2.5 * len(rows)), layout="constrained", squeeze=False
    )
    for swept, line in zip(rows, axes, strict=True):
        for heading, panel in zip(metrics, line, strict=True):
            for k, (law, found) in enumerate(swept.metrics[heading].items()):
                there = [(x, y) for x, y in zip(swept.values, found, strict=True) if y is not None]
                if there:
                    panel.plot(*zip(*there, strict=True), color=COLOURS[k], marker="os^"[k % 3], label=law)
            numbers = [y for laws in swept.metrics[heading].values() for y in laws if y]
            if numbers and max(numbers) > WIDE * min(numbers):
                panel.set_yscale("log")
            panel.set_title(heading, fontsize=9)
            panel.set_xlabel(swept.label, fontsize=8)
            panel.tick_params(labelsize=7)
            panel.grid(alpha=0.3)
        if line is axes[0] or len(swept.metrics[metrics[0]]) > 1:
            line[0].legend(fontsize=7)
    _save(figure, file)


def _band(axes: Axes, time_s: Array, series: Sequence[Array], colour: str) -> None:
    """The 90 % range over the seeds."""
    if len(series) > 1:
        rows = min(map(len, series))
        low, high = np.percentile(np.stack([each[:rows] for each in series]), [5, 95], axis=0)
        axes.fill_between(time_s[:rows], low, high, color=colour, alpha=0.2, linewidth=0)


def _shade(axes: Axes, span_s: tuple[float, float] | None) -> None:
    if span_s:
        axes.axvspan(*span_s, color="#999999", alpha=0.25, linewidth=0)


def _dress(axes: Axes, title: str, unit: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("time [s]", fontsize=8)
    axes.set_ylabel(unit, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)


def _save(figure: Figure, file: Path) -> None:
    figure.savefig(file, dpi=DPI, metadata={"Software": None})
    plt.close(figure)
