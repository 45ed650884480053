"""The matrix: every fault, with every number of arms, under every law, over seeds; and what each cell came to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deploy.chaos.catalogue import Fault
from deploy.chaos.outcome import OUTCOMES, Judgement, Outcome, outcome_counts, verdict_counts
from deploy.chaos.storm import Carry, in_time, is_valid, short_carry
from deploy.planned_run import Run
from sim_server.errors import SimError

CONTROL = "no fault"
"""The row that nothing happens in: what a law cannot do undisturbed is no fault's doing."""

STREAM = 0x3A7
TRIES = 100


class MatrixError(SimError):
    """No such matrix can be drawn."""


@dataclass(frozen=True, slots=True)
class Cell:
    """All seeds of one fault with one team."""

    fault: str
    arms: int
    preset: str
    runs: tuple[Run, ...]
    """One per seed."""


def plan_matrix(rows: Sequence[Fault], arms: Sequence[int], presets: Sequence[str], seeds: range) -> list[Cell]:
    """The cells, fault by fault, the control first. A seed strikes both laws alike: same time, arm and strength.

    Raises:
        MatrixError: a fault that these carries cannot have.
    """
    cells = []
    for row in (None, *rows):
        for count in arms:
            for preset in presets:
                carry = short_carry(count, preset)
                name = CONTROL if row is None else row.name
                runs = tuple(_run(carry, name, row, count, preset, seed) for seed in seeds)
                cells.append(Cell(name, count, preset, runs))
    return cells


def _run(carry: Carry, name: str, row: Fault | None, arms: int, preset: str, seed: int) -> Run:
    group = f"{arms} arms"
    if row is None:
        return carry.run(group, name, preset, [], seed)
    draws = np.random.default_rng([seed, STREAM, arms, *name.encode()])
    for _ in range(TRIES):
        events = in_time(row.draw(draws, carry.resolved.arms, carry.window_s))
        if is_valid(carry, events):
            return carry.run(group, name, preset, events, seed)
    raise MatrixError(
        f"fault {name}: none of {TRIES} draws is an event that {carry.scenario} with {arms} arms can have"
    )


@dataclass(frozen=True)
class Judged:
    """A cell with what its runs came to."""

    cell: Cell
    judgements: tuple[Judgement, ...]
    """One per run."""

    @property
    def outcomes(self) -> Mapping[Outcome, int]:
        """How many of each; all are named."""
        return outcome_counts(self.judgements)


def judged(cells: Sequence[Cell], by_place: Mapping[str, Judgement]) -> list[Judged]:
    """The cells with their judgements."""
    return [Judged(cell, tuple(by_place[run.place] for run in cell.runs)) for cell in cells]


def table(cells: Sequence[Judged]) -> str:
    """The survival table in Markdown: a row a fault, a column a team; how many runs of each outcome and verdict."""
    teams = list(dict.fromkeys((each.cell.arms, each.cell.preset) for each in cells))
    found = {(each.cell.fault, each.cell.arms, each.cell.preset): each for each in cells}
    lines = [
        "| fault | " + " | ".join(f"{arms} arms, `{preset}`" for arms, preset in teams) + " |",
        "|---" * (1 + len(teams)) + "|",
    ]
    for fault in dict.fromkeys(each.cell.fault for each in cells):
        words = (_words(found[fault, *team]) for team in teams)
        lines.append(f"| {fault} | " + " | ".join(words) + " |")
    return "\n".join(lines) + "\n"


def _words(each: Judged) -> str:
    outcomes = ", ".join(f"{count} {name}" for name, count in each.outcomes.items() if count)
    verdicts = " / ".join(str(count) for count in verdict_counts(each.judgements).values())
    return f"{outcomes} ({verdicts})"


def report(cells: Sequence[Judged], command: str, cost: str, picture: str) -> str:
    """matrix.md."""
    runs = sum(len(each.judgements) for each in cells)
    broken = [
        f"- {run.name}: {finding.invariant}: {finding.text} (`{run.place}`)"
        for each in cells
        for run, judgement in zip(each.cell.runs, each.judgements, strict=True)
        for finding in judgement.findings
        if finding.verdict != "holds"
    ]
    parts = [
        "# Where the team still carries, where it only stops safely, and where it drops",
        f"Made by `{command}`: {runs} runs, a process for every follower, each in lock-step. A fault's time, arm and "
        f"strength are drawn from the seed, the same for every law. {cost}",
        f"![Survival map]({picture})",
        "In a cell: how many runs came to which outcome, and in brackets how many of the runs' verdicts by all "
        "invariants hold / are violated / are unknown.",
        table(cells),
        "\n".join(f"- **{name}**: {meaning}" for name, meaning in OUTCOMES.items()),
        "## What does not hold",
        "\n".join(broken) or "Everything holds.",
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def describe(cells: Sequence[Judged], root: Path, command: str) -> dict[str, Any]:
    """matrix.json: every run with its scenario, its changes and its judgement."""
    return {
        "command": command,
        "runs_under": str(root),
        "runs": [
            {
                "fault": each.cell.fault,
                "arms": each.cell.arms,
                "preset": each.cell.preset,
                "seed": run.seed,
                "place": run.place,
                "scenario": run.scenario,
                "changes": dict(run.changes),
                **asdict(judgement),
            }
            for each in cells
            for run, judgement in zip(each.cell.runs, each.judgements, strict=True)
        ],
    }
