"""``palanquin plot``: figures of runs beside each other, one for each question. Needs the extra ``view``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # before pyplot: no display needed

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from deploy.exit_status import BAD_INPUT, fail
from deploy.picture import COLOURS
from deploy.see.curves import LEADER, LOAD, QUESTIONS, Array, Question, Start, curves
from sim_server.metrics import trace_facts
from sim_server.run_folder import TRACE, RunFolderError, read_run
from sim_server.scenario import arm_number
from sim_server.trace import read_trace

PATH = Question("path", "Which way does it go?", "way of the load", "m")
FORMATS = ("png", "svg", "pdf")
STYLES = ("-", "--", "-.", ":")
"""Of the runs, one after the other: colour alone tells no two of them apart."""
MOST_RUNS = 12
STYLE: Mapping[str, Any] = {
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "pdf.fonttype": 42,  # text that can be searched and edited
    "svg.fonttype": "none",
    "svg.hashsalt": "palanquin",  # the same figure, the same bytes
    "savefig.dpi": 300,
}
WIDTH_IN = 3.5
"""A column of a two-column paper."""


@dataclass(frozen=True, eq=False)
class Plotted:
    """A run, as far as it is plotted."""

    name: str
    time_s: Array
    way: Array
    """Of the load in the plane, (rows, 2) m."""
    goal_m: tuple[float, float] | None
    lines: Mapping[Question, Mapping[str, Array]]


def plot_runs(folders: Sequence[Path], out: Path, only: str | None, format_: str) -> list[Path]:
    """Write the figures and return their files. A question that no run answers has none.

    Raises:
        RunFolderError: one of them is no run folder.
    """
    if format_ not in FORMATS:
        fail(f"--format {format_}: expected {', '.join(FORMATS)}", BAD_INPUT)
    questions = _chosen(only)
    if len(folders) > MOST_RUNS:
        fail(f"{len(folders)} runs: expected at most {MOST_RUNS} in one figure", BAD_INPUT)
    runs = _named([_read(folder) for folder in folders], folders)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        fail(f"--out {out}: no folder can be made there: {error.strerror}", BAD_INPUT)
    files = []
    style: Any = dict(STYLE)
    with plt.rc_context(style):
        for question in questions:
            figure = _path(runs) if question is PATH else _figure(question, runs)
            if figure is None:
                continue
            file = out / f"{question.key}.{format_}"
            part = file.with_name(f"{file.name}.part")
            figure.savefig(part, format=format_, metadata={"Date": None} if format_ == "svg" else None)
            plt.close(figure)
            os.replace(part, file)
            files.append(file)
    return files


def _chosen(only: str | None) -> list[Question]:
    known = {question.key: question for question in (PATH, *QUESTIONS)}
    names = list(known) if only is None else [name.strip() for name in only.split(",")]
    if unknown := [name for name in names if name not in known]:
        fail(f"--only {','.join(unknown)}: expected some of {', '.join(known)}", BAD_INPUT)
    return [known[name] for name in names]


def _read(folder: Path) -> Plotted:
    about = read_run(folder)
    try:
        trace, facts = read_trace(folder / TRACE), trace_facts(about["facts"])
        if not trace["time_s"].size:
            raise ValueError("the trace has no rows: the run ended before its first tick")
        lines = curves(trace, facts, Start.of(trace))
        name = f"{about['scenario_name']}, seed {about['seed']}"
        return Plotted(name, trace["time_s"], trace["load.position"][:, :2], facts.goal_m, lines)
    except (OSError, ValueError, LookupError, TypeError) as error:
        problem = " ".join(str(error).split())
        raise RunFolderError(f"{folder}: nothing can be plotted of it: {type(error).__name__}: {problem}") from None


def _named(runs: list[Plotted], folders: Sequence[Path]) -> list[Plotted]:
    """Runs that have the same name bear their folders' too."""
    names = [run.name for run in runs]
    return [
        Plotted(f"{run.name} ({folder.name})", run.time_s, run.way, run.goal_m, run.lines)
        if names.count(run.name) > 1
        else run
        for run, folder in zip(runs, folders, strict=True)
    ]


def _figure(question: Question, runs: Sequence[Plotted]) -> Any:
    """All runs in one panel where each has one line; a panel for each run, with its arms, where it has several."""
    answering = [run for run in runs if question in run.lines]
    if not answering:
        return None
    if all(set(run.lines[question]) <= {LOAD, LEADER} for run in answering):
        figure, axes = plt.subplots(figsize=(WIDTH_IN, 2.4), layout="constrained")
        for k, run in enumerate(runs):
            if question in run.lines:
                (line,) = run.lines[question].values()
                axes.plot(run.time_s, line, color=COLOURS[k % len(COLOURS)], linestyle=_style(k), label=run.name)
        _label(axes, question, legend=len(answering) > 1)
        axes.set_title(question.text if len(answering) > 1 else f"{question.text} ({answering[0].name})")
        return figure
    height = 2.0 * len(answering) + 0.4
    figure, panels = plt.subplots(
        len(answering), figsize=(WIDTH_IN, height), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for run, axes in zip(answering, panels[:, 0], strict=True):
        for arm, line in run.lines[question].items():
            number = arm_number(arm)
            style = STYLES[number // len(COLOURS) % len(STYLES)]
            axes.plot(run.time_s, line, color=COLOURS[number % len(COLOURS)], linestyle=style, label=arm)
        axes.set_title(run.name)
        _label(axes, question, legend=axes is panels[0, 0], last=axes is panels[-1, 0])
    figure.suptitle(question.text)
    return figure


def _path(runs: Sequence[Plotted]) -> Any:
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 2.6), layout="constrained")
    for k, run in enumerate(runs):
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(*run.way.T, color=colour, linestyle=_style(k), label=run.name)
        axes.plot(*run.way[-1], "o", color=colour, markersize=3)
    for goal in {run.goal_m for run in runs if run.goal_m is not None}:
        axes.plot(*goal, "x", color="black", markersize=7, label="goal")
    axes.set(xlabel="x [m]", ylabel="y [m]", title=PATH.text, aspect="equal")
    axes.set_adjustable("datalim")
    axes.legend()
    return figure


def _style(k: int) -> str:
    return STYLES[k % len(STYLES)]


def _label(axes: Axes, question: Question, *, legend: bool, last: bool = True) -> None:
    axes.set_ylabel(f"{question.quantity} [{question.unit}]")
    if last:
        axes.set_xlabel("time [s]")
    if legend:
        axes.legend(fontsize=7, ncols=2 if len(axes.get_lines()) > 3 else 1)
