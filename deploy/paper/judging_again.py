"""Whether a report's verdicts follow from its numbers, and its numbers from runs made anew."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import ge, le
from pathlib import Path
from typing import Any

from deploy.batch import BatchError, is_there, run_one
from deploy.paper.judging import CLAIMS, Claim, verdict_of
from deploy.paper.results import Results
from deploy.paper.targets import TARGETS
from deploy.paper.verifying import close, run_of, values_of
from deploy.planned_run import Run

MEETS: Mapping[str, Callable[[float, float], bool]] = {"<=": le, ">=": ge}


class MadeAgain(Results):
    """The runs of a report, each run when it is asked for."""

    def __init__(self, report: Mapping[str, Any], root: Path) -> None:
        super().__init__(root, map(run_of, report["runs"]))
        self._where = root

    def run(self, group: str, condition: str, law: str, seed: int) -> Run:
        """Raises :class:`deploy.paper.results.NoSuchRun`, and :class:`BatchError` if it could not be run."""
        run = super().run(group, condition, law, seed)
        if not is_there(run, self._where):
            problem = run_one(run, str(self._where / run.place))
            if problem:
                raise BatchError(f"{run.name} could not be run again: {problem}")
        return run


@dataclass(frozen=True, slots=True)
class Drawn:
    """A claim with one of its seeds, and what the report says was measured in that."""

    claim: Claim
    law: str
    seed: int
    reported: float

    @property
    def name(self) -> str:
        """As the verb prints it."""
        return f"{self.claim.name}, {self.law}, seed {self.seed}"


def unfounded(report: Mapping[str, Any]) -> list[str]:
    """Claims whose verdict is not what their values and their bound make of it."""
    wrong = []
    for each in report["claims"]:
        if each["values"]:
            relation, bound = each["bound"].split()
            verdict = verdict_of([MEETS[relation](value, float(bound)) for value in each["values"]])
            if verdict != each["verdict"]:
                wrong.append(f"{each['name']}, {each['law']}")
    return wrong


def drawn(report: Mapping[str, Any], count: int, seed: int) -> list[Drawn]:
    """So many of its claims and seeds, drawn from the seed."""
    known = {claim.name: claim for claim in (*CLAIMS, *TARGETS)}
    all_of_them = [
        Drawn(known[each["name"]], each["law"], number, value)
        for each in report["claims"]
        if each["name"] in known
        for number, value in values_of(each)
    ]
    return random.Random(seed).sample(all_of_them, min(count, len(all_of_them)))


def judged_again(each: Drawn, runs: MadeAgain, *, exact: bool) -> tuple[bool, float]:
    """Whether it came out as reported, and what was found.

    Args:
        exact: with the same versions every bit has to be the same.
    """
    found = each.claim.check(runs, each.law, each.seed).value
    return found == each.reported or (not exact and close(found, each.reported)), found
