"""Two files of the bench side by side. Judged are ratios alone: a time says how fast the machine was just then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from deploy.bench.figures import RATIO, Figure, NoBenchFile, Part

Judged = Literal["better", "worse", "same"] | None
"""None: not to be compared."""


@dataclass(frozen=True, slots=True)
class Compared:
    """A figure that both files have."""

    part: str
    old: Figure
    new: Figure

    @property
    def change(self) -> float | None:
        """New over old; None where the old one is zero."""
        return self.new.value / self.old.value if self.old.value else None

    @property
    def judged(self) -> Judged:
        """``same`` unless the ranges of the turns do not meet."""
        if self.old.unit != RATIO or not self.old.better:
            return None
        if self.new.low > self.old.high:
            return "better" if self.old.better == "more" else "worse"
        if self.new.high < self.old.low:
            return "worse" if self.old.better == "more" else "better"
        return "same"


def compared(old: Mapping[str, Part], new: Mapping[str, Part]) -> list[Compared]:
    """All figures that both have, in the order of the new one.

    Raises:
        NoBenchFile: they have none in common.
    """
    before = {
        (name, figure.row, figure.column, figure.unit): figure for name, part in old.items() for figure in part.figures
    }
    rows = [
        Compared(name, before[key], figure)
        for name, part in new.items()
        for figure in part.figures
        if (key := (name, figure.row, figure.column, figure.unit)) in before
    ]
    if not rows:
        raise NoBenchFile("the two files have no figure in common: expected two with the same parts and teams")
    return rows
