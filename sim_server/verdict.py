"""The verdict of a run: its metrics against the scenario's ``[expect]``. holds, violated, or unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


def overall(judged: tuple[Judged, ...], completed: bool, unproven: Sequence[str] = ()) -> Verdict:
    """The run's verdict: unknown if it did not reach its end (a goal not reached yet is not a goal missed), or if an
    event of its scenario was not seen to take effect (then it is another run), else violated if any bound is, else
    unknown if any is."""
    verdicts = {row.verdict for row in judged}
    if not completed or unproven:
        return "unknown"
    if "violated" in verdicts:
        return "violated"
    return "unknown" if "unknown" in verdicts else "holds"


def why_unknown(judged: tuple[Judged, ...], ended: str | None, unproven: Sequence[str]) -> list[str]:
    """A sentence for each thing for which the verdict is unknown, or would be.

    Args:
        ended: why the run ended before its end; None if it reached it.
        unproven: for each event without an effect that was seen.
    """
    unmeasured = [f"{row.metric} does not exist for this run" for row in judged if row.verdict == "unknown"]
    early = [] if ended is None else [f"the run did not reach its end: {ended}"]
    return [*early, *unproven, *unmeasured]
