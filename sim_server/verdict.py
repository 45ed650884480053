"""The verdict of a run: its metrics against the scenario's ``[expect]``. holds, violated, or unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from sim_server.scenario import Bound

Verdict = Literal["holds", "violated", "unknown"]


@dataclass(frozen=True, slots=True)
class Judged:
    """One bound beside what was measured."""

    metric: str
    value: float | None
    bound: Bound
    verdict: Verdict

    @property
    def expected(self) -> str:
        """The bound in words, such as ``<= 0.1``."""
        low = "" if self.bound.min is None else f">= {self.bound.min:g}"
        high = "" if self.bound.max is None else f"<= {self.bound.max:g}"
        return " and ".join(part for part in (low, high) if part)


def judge(metrics: Mapping[str, Any], expect: Mapping[str, Bound]) -> tuple[Judged, ...]:
    """Hold every bound against its metric. A metric that is missing or None cannot be judged: unknown."""
    return tuple(_judge_one(metric, metrics.get(metric), bound) for metric, bound in expect.items())


def _judge_one(metric: str, value: object, bound: Bound) -> Judged:
    if not isinstance(value, int | float):
        return Judged(metric, None, bound, "unknown")
    low = bound.min is None or value >= bound.min
    high = bound.max is None or value <= bound.max
    return Judged(metric, float(value), bound, "holds" if low and high else "violated")


def overall(judged: tuple[Judged, ...], completed: bool) -> Verdict:
    """The run's verdict: unknown if it did not reach its end (a goal not reached yet is not a goal missed), else
    violated if any bound is, else unknown if any is."""
    verdicts = {row.verdict for row in judged}
    if not completed:
        return "unknown"
    if "violated" in verdicts:
        return "violated"
    return "unknown" if "unknown" in verdicts else "holds"
