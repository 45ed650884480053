"""How well everybody kept time: ticks missed, ages of the commands obeyed, and how late the server itself was."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sim_server.durations import Durations
from sim_server.reception import LEADER, Agent
from sim_server.snapshot import Snapshot

LATE_UP_TO_US = (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000)
"""Upper edges of the histogram of late starts."""


@dataclass(slots=True)
class Punctuality:
    """What a clock notes while it runs. Under lock-step only the misses mean anything: the rest stays empty."""

    ages: dict[str, Counter[int]] = field(default_factory=dict)
    """Per agent: in how many ticks the command in force was that old. The age is the number of ticks from the state
    that it answers to the tick that it acts in: 0 is in time."""
    late: Durations = field(default_factory=Durations)
    """How late the ticks began, by the wall clock."""
    late_edges: Counter[int] = field(default_factory=Counter)
    """The same, by the first of the edges above that it does not pass."""
    oldest: int = 0
    """The greatest age so far, of an arm's command."""
    slowed_ns: int = 0
    """Wall time that simulated time was let fall behind, because the machine could not keep up."""

    def note_age(self, name: str, age: int) -> None:
        """The command of this agent that acts in this tick is so old."""
        self.ages.setdefault(name, Counter())[age] += 1
        if name != LEADER:
            self.oldest = max(self.oldest, age)

    def note_late(self, late_ns: int) -> None:
        """A tick of the real-time clock began so late."""
        self.late.append(late_ns)
        self.late_edges[bisect_left(LATE_UP_TO_US, late_ns / 1e3)] += 1

    def describe(self, agents: Mapping[str, Agent]) -> dict[str, Any]:
        """Everything for run.json; the histograms only in real time."""
        arms = [agent.link for name, agent in agents.items() if name != LEADER]
        sent = sum(link.states_sent for link in arms)
        in_real_time = bool(self.late)
        found: dict[str, Any] = {
            "missed_percent": 100.0 * sum(link.missed for link in arms) / sent if sent else 0.0,
            "missed_in_row_max": max((link.longest_miss for link in arms), default=0),
            "age_max_ticks": self.oldest if in_real_time else None,
            "slowed_s": 1e-9 * self.slowed_ns if in_real_time else None,
        }
        if in_real_time:
            found |= {
                "missed_ticks": {name: agent.link.missed for name, agent in agents.items()},
                "age_ticks": {name: {str(age): ages[age] for age in sorted(ages)} for name, ages in self.ages.items()},
                "tick_late_us": {**self.late.spread_us(), "max": self.late.max_ns / 1e3},
                "tick_late_histogram_us": self._late_histogram(),
            }
        return found

    def state(self) -> Snapshot:
        """All of it."""
        return {
            "ages": {name: sorted(ages.items()) for name, ages in self.ages.items()},
            "oldest": self.oldest,
            "slowed_ns": self.slowed_ns,
            "late": self.late.state(),
            "late_edges": sorted(self.late_edges.items()),
        }

    def restore(self, saved: Snapshot) -> None:
        """Note on from there."""
        self.ages = {name: Counter({int(age): int(n) for age, n in ages}) for name, ages in saved["ages"].items()}
        self.oldest, self.slowed_ns = int(saved["oldest"]), int(saved["slowed_ns"])
        self.late.restore(saved["late"])
        self.late_edges = Counter({int(edge): int(n) for edge, n in saved["late_edges"]})

    def _late_histogram(self) -> dict[str, int]:
        """Ticks by how late they began: ``"50"`` counts those above the edge before it and up to 50 us."""
        edges = [*(str(edge) for edge in LATE_UP_TO_US), "more"]
        return {edge: self.late_edges[k] for k, edge in enumerate(edges)}
