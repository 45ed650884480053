"""Real time: how well the wall clock is kept at a rate, with nobody waiting for anybody."""

from __future__ import annotations

from collections.abc import Callable

from deploy.bench.carry import Carry, carry
from deploy.bench.figures import Part, Samples
from deploy.bench.plan import Plan, team_of

LEADER_MS = 12
"""A multiple of every period that there is."""


def measure_real_time(plan: Plan, tell: Callable[[str], None]) -> Part:
    """Misses, ages and jitter at every rate."""
    samples = Samples()
    for k in range(plan.turns):
        for rate in plan.rates_hz:
            tell(f"turn {k + 1} of {plan.turns}, {rate} Hz")
            changes = {
                "clock": {"mode": "real-time", "control_period_ms": 1000 // rate},
                "leader": {"period_ms": LEADER_MS},
            }
            _add(samples, f"{rate} Hz", carry(team_of(plan.team), plan.seconds, changes))
    return Part(
        "real-time",
        f"Real time, {plan.team} arms",
        samples.figures(),
        (
            "In time: ticks in which an arm's command answers that very tick. Late: from a tick's moment by the clock "
            "to its beginning.",
        ),
    )


def _add(samples: Samples, column: str, found: Carry) -> None:
    """The figures of one carry."""
    measured = found.measured
    ages = [each for name, each in measured["age_ticks"].items() if name != "leader"]
    ticks = sum(sum(each.values()) for each in ages)
    in_time = sum(each.get("0", 0) for each in ages)
    late = measured["tick_late_us"]
    samples.add("simulated time / wall time", column, "x", measured["real_time_factor"], "more")
    samples.add("missed", column, "%", measured["missed_percent"], "less", positive=False)
    samples.add("missed in a row, most", column, "ticks", measured["missed_in_row_max"], "less", positive=False)
    samples.add("commands in time", column, "%", 100.0 * in_time / ticks if ticks else 0.0, "more", positive=False)
    samples.add("oldest command", column, "ticks", measured["age_max_ticks"], "less", positive=False)
    samples.add("arms lost", column, "arms", len(found.lost), "less", positive=False)
    samples.add("late, p50", column, "us", late["p50"], "less", positive=False)
    samples.add("late, p99", column, "us", late["p99"], "less", positive=False)
    samples.add("late, most", column, "us", late["max"], "less", positive=False)
