"""From finished runs to the report's files: claims, figures, tables."""

from __future__ import annotations

import logging
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from deploy.paper import figures
from deploy.paper.ablations import TIMES_THREE
from deploy.paper.figures import Shown
from deploy.paper.judging import CLAIMS, TARGETS, TRAJECTORY, Judged, disturbed_s, judge, wanted_height
from deploy.paper.plan import SECTION_VI, Run
from deploy.paper.report import (
    ablation_tables,
    claims_table,
    comparison_table,
    conditions_table,
    cost_text,
    describe,
    runs_table,
    sweep_tables,
    targets_table,
    to_html,
    write_json,
)
from deploy.paper.results import Results, hand_places
from deploy.paper.verifying import REPORT

log = logging.getLogger("palanquin.paper")

LAWS = ("paper", "palanquin")
"""The laws whose claims are judged."""


def make_report(runs: Sequence[Run], root: Path, out: Path, command: str) -> tuple[Judged, ...]:
    """Judge, draw and write: paper.md, paper.html, paper.json and the figures into ``out``.

    Args:
        runs: those that are there, under ``root``.
        command: that made them, for the reader.
    """
    results = Results(root, runs)
    judged = {law: tuple(judge(claim, results, law) for claim in CLAIMS) for law in LAWS}
    out.mkdir(parents=True, exist_ok=True)
    targets = tuple(judge(claim, results, "palanquin") for claim in TARGETS)
    drawn = _draw(results, out)
    text = _text(runs, results, judged, targets, drawn, command)
    (out / "paper.md").write_text(text, encoding="utf-8")
    (out / "paper.html").write_text(to_html(text, out, "The paper, reproduced"), encoding="utf-8")
    everything = (*judged["paper"], *judged["palanquin"], *targets)
    write_json(out / REPORT, describe(runs, results, everything, command))
    return everything


def _draw(results: Results, out: Path) -> dict[str, str]:
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


def _text(
    runs: Sequence[Run],
    results: Results,
    judged: Mapping[str, Sequence[Judged]],
    targets: Sequence[Judged],
    drawn: dict[str, str],
    command: str,
) -> str:
    seeds = max((len(results.seeds("VI-C", condition.name, "paper")) for condition in SECTION_VI["VI-C"]), default=0)
    parts = [
        "# The paper, reproduced",
        "H. E. Carey and J. Werfel, *Collective Transport of Unconstrained Objects via Implicit Coordination and "
        "Adaptive Compliance*, section VI: every experiment through the whole system, a process for every follower, "
        "Zenoh between them, lock-step at 1 kHz.",
        f"Made by `{command}`: {seeds} seeds a condition. A seed draws how the arms differ from their models, the "
        "sensors' noise and how the robots stand at the start. Numbers are medians over the seeds with the range of "
        "the middle 90 %. A claim holds if it does in at least 95 % of the seeds, does not hold if it does in no more "
        "than half, and else is open. `palanquin verify` runs a sample of this again. " + cost_text(runs, results),
        "## Claims, with the paper's law",
        claims_table(judged["paper"]),
        *(f"## {title}\n\n![{title}]({file})" for title, file in drawn.items()),
        "## The same claims, with the law `palanquin`",
        claims_table(judged["palanquin"]),
        *_section("What is asked of `palanquin`", targets_table(targets)),
        *_section(
            "Where `palanquin` beats `paper`, and where it does not",
            comparison_table(results),
            "Medians of both over the seeds; what is worse with `palanquin` stands in bold type.",
        ),
        "## All conditions, both laws",
        *(f"### {group}\n\n{conditions_table(results, group)}" for group in SECTION_VI),
        *_section("VI-C with three times the differences", conditions_table(results, TIMES_THREE, "VI-C")),
        *_section("VI-B, swept", sweep_tables(results)),
        *_section(
            "What the paper leaves out",
            ablation_tables(results),
            "One thing changed at a time, on the undisturbed carry; fewer seeds. A load that was thrown has the "
            "numbers of the time until then.",
        ),
        "## What it rests on",
        "Every run's scenario, settings, seed, digest and metrics are in paper.json; "
        "`palanquin run SCENARIO --seed N --set ...` with these is that run. The digests here are over those of the "
        "resolved scenarios.",
        runs_table(runs),
    ]
    return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n"


def _section(title: str, table: str, before: str = "") -> tuple[str, ...]:
    """Heading, words and table; nothing without a table."""
    return (f"## {title}", before, table) if table else ()
