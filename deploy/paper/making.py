"""From finished runs to the report's files: claims, figures, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from deploy.paper.ablations import TIMES_THREE
from deploy.paper.drawing import LAWS, draw, draw_ablations, draw_sweeps
from deploy.paper.judging import CLAIMS, Judged, judge
from deploy.paper.plan import SECTION_VI
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
    versions_text,
    write_json,
)
from deploy.paper.results import Results
from deploy.paper.targets import TARGETS
from deploy.paper.verifying import REPORT
from deploy.planned_run import Run

ABLATIONS_PNG, SWEEPS_PNG = "paper-ablations.png", "paper-sweeps.png"


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
    drawn = draw(results, out)
    curves = draw_ablations(results, out / ABLATIONS_PNG)
    sweeps = draw_sweeps(results, out / SWEEPS_PNG)
    text = _text(runs, results, judged, targets, drawn, command, curves=curves, sweeps=sweeps)
    (out / "paper.md").write_text(text, encoding="utf-8")
    (out / "paper.html").write_text(to_html(text, out, "The paper, reproduced"), encoding="utf-8")
    everything = (*judged["paper"], *judged["palanquin"], *targets)
    write_json(out / REPORT, describe(runs, results, everything, command))
    return everything


def _text(
    runs: Sequence[Run],
    results: Results,
    judged: Mapping[str, Sequence[Judged]],
    targets: Sequence[Judged],
    drawn: dict[str, str],
    command: str,
    *,
    curves: bool,
    sweeps: bool,
) -> str:
    seeds = max((len(results.seeds("VI-C", condition.name, "paper")) for condition in SECTION_VI["VI-C"]), default=0)
    parts = [
        "# The paper, reproduced",
        "Carey and Werfel, *Collective Transport of Unconstrained Objects via Implicit Coordination and "
        "Adaptive Compliance*, section VI: every experiment through the whole system, a process for every follower, "
        "Zenoh between them, lock-step at 1 kHz.",
        f"Made by `{command}`: {seeds} seeds of every condition of section VI, fewer of what stands beside it (the "
        "tables say how many). A carry is simulated for as long as its heading says, most of them shorter than their "
        'scenario: numbers are of that time, and "later" is not never. A seed draws how the arms differ from their '
        "models, the sensors' noise and how the robots stand at the start. Numbers are medians over the seeds with the "
        "range of the middle 90 %. A claim holds if it does in at least 95 % of the seeds, does not hold if it does in "
        "no more than half, and else is open. `palanquin verify` runs a sample of this again.",
        cost_text(runs, results),
        "## Claims, with the paper's law",
        claims_table(judged["paper"]),
        *(f"## {title}\n\n![{title}]({file})" for title, file in drawn.items()),
        "## The same claims, with the law `palanquin`",
        claims_table(judged["palanquin"]),
        *_section("What is asked of `palanquin`", targets_table(targets)),
        *_section(
            "Where `palanquin` beats `paper`, and where it does not",
            comparison_table(results),
            "Medians of both over the seeds, of the time that was simulated; what is worse with `palanquin` is in bold "
            'type. "later": not within that time.',
        ),
        "## All conditions, both laws",
        *(f"### {group}\n\n{conditions_table(results, group)}" for group in SECTION_VI),
        *_section("VI-C with three times the differences", conditions_table(results, TIMES_THREE, "VI-C")),
        *_section("VI-B, swept", (f"![Error and torque]({SWEEPS_PNG})\n\n" if sweeps else "") + sweep_tables(results)),
        *_section(
            "What the paper leaves out",
            (f"![Metrics over what is changed]({ABLATIONS_PNG})\n\n" if curves else "") + ablation_tables(results),
            "One thing changed at a time, on the undisturbed carry; fewer seeds. A load that was thrown has the "
            "numbers of the time until then.",
        ),
        "## What it rests on",
        "Every run's command, scenario, settings, seed, digest and metrics are in paper.json, with the versions of "
        f"all that it ran on: {versions_text(runs, results)}. The digests here are over those of the resolved "
        "scenarios.",
        runs_table(runs),
    ]
    return "\n\n".join(part.strip() for part in parts if part.strip()) + "\n"


def _section(title: str, table: str, before: str = "") -> tuple[str, ...]:
    """Heading, words and table; nothing without a table."""
    return (f"## {title}", before, table) if table else ()
