"""The report: docs/paper.md with its figures, the same as one HTML file, and paper.json, on which both rest."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deploy.paper.ablations import ABLATIONS, SWEEPS
from deploy.paper.claims import rms, summed_torque
from deploy.paper.judging import Judged, height_error
from deploy.paper.plan import SECTION_VI
from deploy.paper.results import Results
from deploy.paper.statistics import Spread, spread
from deploy.paper.verifying import physical, sha256_of
from deploy.planned_run import Run

WORDS = {"holds": "holds", "violated": "**does not hold**", "unknown": "open"}
COMPARED = (
    ("tilt_max_deg", "tilt, largest [deg]"),
    ("sag_max_mm", "sag, largest [mm]"),
    ("yaw_max_deg", "yaw, largest [deg]"),
    ("goal_error_m", "goal error [m]"),
    ("overshoot_m", "overshoot [m]"),
    ("arrival_time_s", "arrival [s]"),
    ("internal_force_rms_N", "internal force [N]"),
    ("torque_rms_Nm", "torque, rms [N m]"),
)
"""Metrics of the tables, with their headings."""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def claims_table(judged: Sequence[Judged]) -> str:
    """Each claim beside what was measured."""
    rows = []
    for each in judged:
        measured = each.spread
        unit = each.found[0].unit if each.found else ""
        rows.append(
            [
                each.claim.name,
                each.claim.says,
                each.claim.measures,
                f"{measured.text()} {unit}".strip() if measured else "no runs",
                each.found[0].bound if each.found else "",
                f"{each.holds_in} of {len(each.found)}",
                WORDS[each.verdict],
            ]
        )
    return table(["claim", "the paper", "measured", "median (90 % range)", "bound", "seeds", ""], rows)


def claims_summary(content: Mapping[str, Any]) -> str:
    """The README's table, from the content of a paper.json: each claim with both laws' medians and verdicts."""
    cells: dict[str, dict[str, str]] = {}
    bounds: dict[str, str] = {}
    for each in content["claims"]:
        if each["values"]:
            number = f"{float(np.median(each['values'])):.3g}"
            text = number if each["verdict"] == "holds" else f"{number}, {WORDS[each['verdict']]}"
            cells.setdefault(each["name"], {})[each["law"]] = text
            bounds[each["name"]] = f"{each['bound']} {each['unit']}".strip()
    rows = [
        [name, bounds[name], by_law["paper"], by_law.get("palanquin", "")]
        for name, by_law in cells.items()
        if "paper" in by_law
    ]
    return table(["claim", "bound", "`paper`", "`palanquin`"], rows)


def targets_table(judged: Sequence[Judged]) -> str:
    """What we ask of our law, beside what was measured."""
    rows = []
    for each in judged:
        if measured := each.spread:
            unit, bound = each.found[0].unit, each.found[0].bound
            seeds = f"{each.holds_in} of {len(each.found)}"
            rows.append([each.claim.says, f"{measured.text()} {unit}", bound, seeds, WORDS[each.verdict]])
    return table(["asked", "median (90 % range)", "bound", "seeds", ""], rows) if rows else ""


def comparison_table(results: Results) -> str:
    """Medians of the paper's law and of ours in every condition of VI-C; what is worse by more than a hundredth stands
    in bold type. "later": not within the time that was simulated."""
    conditions = [c for c in SECTION_VI["VI-C"] if results.seeds("VI-C", c.name, "palanquin")]
    conditions = [c for c in conditions if results.seeds("VI-C", c.name, "paper")]
    rows = []
    for metric, heading in COMPARED:
        cells = []
        for condition in conditions:
            theirs, ours = (results.spread(metric, "VI-C", condition.name, law) for law in ("paper", "palanquin"))
            if theirs is None or ours is None:
                cells.append(f"{_median(theirs)} / {_median(ours)}")
                continue
            is_worse = ours.median > 1.01 * theirs.median
            cells.append(f"{_median(theirs)} / " + (f"**{_median(ours)}**" if is_worse else _median(ours)))
        rows.append([heading, *cells])
    head = ["`paper` / `palanquin`", *(f"{c.label}, {c.duration_s:g} s" for c in conditions)]
    return table(head, rows) if conditions else ""


def _median(found: Spread | None) -> str:
    return f"{found.median:.3g}" if found else "later"


def cost_text(runs: Sequence[Run], results: Results) -> str:
    """What the runs cost."""
    costs = [cost for run in {run.place: run for run in runs}.values() if (cost := results.cost(run))]
    processor_s = sum(cost["processor_s"] for cost in costs)
    return (
        f"These {len(costs)} runs took {processor_s / 60:.0f} minutes of processor time: "
        f"{processor_s / 120:.0f} minutes of two cores that do nothing else."
    )


def conditions_table(results: Results, group: str, experiment: str | None = None) -> str:
    """Metrics of every condition and law of an experiment; ``group`` is another name under which it was run."""
    rows = []
    for condition in SECTION_VI[experiment or group]:
        for preset in condition.presets:
            if results.seeds(group, condition.name, preset):
                label = f"{condition.label}, {condition.duration_s:g} s"
                rows.append([label, preset, *_metrics(results, group, condition.name, preset)])
    return table(["condition", "law", *(heading for _, heading in COMPARED)], rows) if rows else ""


def ablation_tables(results: Results) -> str:
    """A table for each ablation."""
    parts = []
    for ablation in ABLATIONS:
        rows = [
            [value, preset, *_metrics(results, ablation.name, value, preset)]
            for value in ablation.values
            for preset in ablation.presets
            if results.seeds(ablation.name, value, preset)
        ]
        if rows:
            head = [ablation.label, "law", *(heading for _, heading in COMPARED)]
            parts.append(f"### {ablation.label.capitalize()}\n\n{table(head, rows)}")
    return "\n".join(parts)


def swept(results: Results, sweep: str, value: str, preset: str) -> dict[str, Spread | None]:
    """What a sweep of the trajectory is about, by its heading."""
    runs = [results.run(sweep, value, preset, seed) for seed in results.seeds(sweep, value, preset)]
    return {
        "height error, rms [mm]": spread(1e3 * rms(height_error(results, run)) for run in runs),
        "summed torque, mean [N m]": spread(float(summed_torque(results.trace(run)).mean()) for run in runs),
    }


def sweep_tables(results: Results) -> str:
    """A table for each sweep of the trajectory: error of the hand's height, and the joints' summed torque."""
    parts = []
    for sweep in SWEEPS:
        rows = []
        for value in sweep.values:
            for preset in sweep.presets:
                found = swept(results, sweep.name, value, preset)
                if all(found.values()):
                    rows.append([value, preset, *(each.text() for each in found.values() if each)])
        if rows:
            head = [sweep.label, "law", *found]
            parts.append(f"### {sweep.label.capitalize()}\n\n{table(head, rows)}")
    return "\n".join(parts)


def _metrics(results: Results, group: str, condition: str, law: str) -> list[str]:
    """The compared metrics as text. A metric that only some seeds have (an arrival) says in how many."""
    seeds = len(results.seeds(group, condition, law))
    cells = []
    for metric, _ in COMPARED:
        found = results.spread(metric, group, condition, law)
        some = f" ({found.count} of {seeds})" if found and found.count < seeds else ""
        cells.append(found.text() + some if found else "none")
    return cells


def describe(runs: Sequence[Run], results: Results, judged: Sequence[Judged], command: str) -> dict[str, Any]:
    """The content of paper.json: every run that the report rests on, with the digests of what went in and came out."""
    return {
        "command": command,
        "versions": versions_of(runs, results),
        "claims": [
            {
                "name": each.claim.name,
                "law": each.preset,
                "verdict": each.verdict,
                "values": [found.value for found in each.found],
                "seeds": list(each.seeds),
                "bound": each.found[0].bound if each.found else "",
                "unit": each.found[0].unit if each.found else "",
            }
            for each in judged
        ],
        "runs": [
            {
                "name": run.name,
                "group": run.group,
                "condition": run.condition,
                "law": run.law,
                "scenario": run.scenario,
                "changes": run.changes,
                "seed": run.seed,
                "command": run.command,
                "digest": run.digest,
                "metrics_sha256": sha256_of(metrics),
                "metrics": metrics,
            }
            for run, metrics in ((run, physical(results.metrics(run))) for run in runs)
        ],
    }


def versions_of(runs: Sequence[Run], results: Results) -> dict[str, str | None]:
    """What the runs ran on; more than one version of something with " or " between them."""
    found: dict[str, dict[str | None, None]] = {}
    for run in runs:
        for name, version in results.about(run)["versions"].items():
            found.setdefault(name, {})[version] = None
    return {name: " or ".join(str(each) for each in those) if any(those) else None for name, those in found.items()}


def versions_text(runs: Sequence[Run], results: Results) -> str:
    """Names and versions in a line."""
    return ", ".join(f"{name} {version}" for name, version in versions_of(runs, results).items() if version)


def runs_table(runs: Sequence[Run]) -> str:
    """The runs by condition and law: how many seeds, and one digest over theirs."""
    grouped: dict[tuple[str, str, str], list[Run]] = {}
    for run in runs:
        grouped.setdefault((run.group, run.condition, run.law), []).append(run)
    rows = []
    for (group, condition, law), those in grouped.items():
        seeds = [run.seed for run in those]
        together = hashlib.sha256("".join(run.digest for run in those).encode()).hexdigest()[:12]
        rows.append([group, condition, law, those[0].scenario, f"{min(seeds)} to {max(seeds)}", f"`{together}`"])
    return table(["experiment", "condition", "law", "scenario", "seeds", "digest"], rows)


def to_html(markdown: str, folder: Path, title: str) -> str:
    """The report as one HTML file, its pictures inside."""
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark").enable("table").render(markdown)

    def inlined(match: re.Match[str]) -> str:
        data = base64.b64encode((folder / match[1]).read_bytes()).decode()
        return f'src="data:image/png;base64,{data}"'

    body = re.sub(r'src="([^":]+\.png)"', inlined, body)
    return (
        f"<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'><title>{title}</title><style>"
        "body{font:15px/1.5 system-ui,sans-serif;max-width:75em;margin:2em auto;padding:0 1em}"
        "table{border-collapse:collapse;font-size:13px}td,th{border:1px solid #ccc;padding:.2em .5em;text-align:left}"
        f"img{{max-width:100%}}</style></head><body>\n{body}</body></html>\n"
    )


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Readable, and the same bytes for the same content."""
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
