"""Median and 90 % range over seeds: no lucky run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Spread:
    """A number over all seeds."""

    median: float
    low: float
    """5th percentile."""
    high: float
    """95th percentile."""
    worst: float
    """The largest."""
    count: int

    def text(self, digits: int = 3) -> str:
        """``median (low to high)``."""
        if self.count == 1:
            return f"{self.median:.{digits}g}"
        return f"{self.median:.{digits}g} ({self.low:.{digits}g} to {self.high:.{digits}g})"


def spread(values: Iterable[float | None]) -> Spread | None:
    """Of the values that there are; None if there are none.

    A value that is missing (a carry that never arrived has no arrival time) is left out; ``count`` says how many are.
    """
    found = np.array([value for value in values if value is not None], dtype=float)
    if not found.size:
        return None
    low, median, high = np.percentile(found, [5, 50, 95]).tolist()
    return Spread(median, low, high, float(found.max()), found.size)
