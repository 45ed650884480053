"""Runs of the chaos bench, each judged by the invariants."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from deploy.batch import COST, Engine, is_there, run_missing, run_one
from deploy.chaos.catalogue import Event
from deploy.chaos.invariants import Finding
from deploy.chaos.outcome import Judgement, judge_folder
from deploy.chaos.shrink import Fails
from deploy.chaos.storm import Carry, is_valid
from deploy.planned_run import Run

Told = Callable[[str], None]


def try_one(run: Run, folder: Path) -> Judgement:
    """Run it into this folder, and judge it; a run that could not be run is unknown, with the reason."""
    problem = run_one(run, str(folder))
    return _unknown(problem) if problem else judge_folder(folder)


def tried(run: Run, root: Path) -> Judgement:
    """The same with its place under this root; what is there is not run again."""
    folder = root / run.place
    return judge_folder(folder) if is_there(run, root) else try_one(run, folder)


def try_all(
    runs: Sequence[Run], root: Path, engine: Engine, told: Callable[[int, int], None]
) -> Mapping[str, Judgement]:
    """Run what is not there yet under this root; every run's judgement, by its place.

    Args:
        told: called with how many are there and how many there are to be.
    """
    problems = run_missing(runs, root, engine, told)
    return {
        place: _unknown(problems[place]) if place in problems else judge_folder(root / place)
        for place in dict.fromkeys(run.place for run in runs)
    }


def failing_as(first: Judgement, carry: Carry, seed: int, root: Path, told: Told) -> Fails:
    """Whether a run with other events violates the invariant that this judgement violates first.

    Args:
        carry: what is carried, with the law and all other changes.
        root: where the runs go; those that are there are not run again.
        told: called with a line for each try.

    Raises:
        ValueError: the judgement violates nothing.
    """
    if not first.violated:
        raise ValueError("the run violates no invariant: there is nothing to shrink")
    invariant = first.violated[0].invariant

    def fails(events: Sequence[Event]) -> bool:
        if not is_valid(carry, events):
            return False
        judgement = tried(carry.run("shrink", invariant, "", events, seed), root)
        found = next((each for each in judgement.violated if each.invariant == invariant), None)
        told(f"{len(events)} events: {invariant} " + (f"violated, {found.text}" if found else "not violated"))
        return found is not None

    return fails


def cost_text(runs: Sequence[Run], root: Path) -> str:
    """What the runs cost, in words."""
    costs = []
    for place in dict.fromkeys(run.place for run in runs):
        if (root / place / COST).exists():
            costs.append(json.loads((root / place / COST).read_text(encoding="utf-8")))
    if not costs:
        return "No run was measured."
    wall_s, processor_s = (sum(each[key] for each in costs) for key in ("wall_s", "processor_s"))
    return (
        f"{len(costs)} runs took {processor_s / 60:.1f} minutes of processor time, {processor_s / len(costs):.1f} s a "
        f"run, and each {wall_s / len(costs):.1f} s of wall time beside those that ran at the same time."
    )


def _unknown(problem: str) -> Judgement:
    return Judgement("unknown", "unknown", (Finding("events_complete", "unknown", f"it could not be run: {problem}"),))
