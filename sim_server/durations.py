"""Wall times of a run as counts of rounded values: a run of any length takes no more memory than a short one."""

from __future__ import annotations

from collections import Counter

import numpy as np

from sim_server.snapshot import Snapshot

KEPT_BITS = 8
"""Leading binary digits that a duration keeps, so that it is rounded down by less than 1 %."""
NOT_YET_COUNTED = 1000
"""Durations that wait to be counted together: the tick that notes one has no time for more than noting it."""


class Durations:
    """How often each duration was seen. At most 128 values are told apart per doubling."""

    __slots__ = ("_counted", "_longest_ns", "_waiting")

    def __init__(self) -> None:
        self._counted: Counter[int] = Counter()
        self._longest_ns = 0
        self._waiting: list[int] = []

    def append(self, ns: int) -> None:
        """Note one."""
        self._waiting.append(ns)
        if len(self._waiting) == NOT_YET_COUNTED:
            self._count()

    def _count(self) -> None:
        for ns in self._waiting:
            shift = max(0, ns.bit_length() - KEPT_BITS)
            self._counted[ns >> shift << shift] += 1
        self._longest_ns = max([self._longest_ns, *self._waiting])
        self._waiting.clear()

    @property
    def _counts(self) -> Counter[int]:
        self._count()
        return self._counted

    @property
    def max_ns(self) -> int:
        """The longest, not rounded."""
        self._count()
        return self._longest_ns

    def __len__(self) -> int:
        return self._counts.total()

    @property
    def told_apart(self) -> int:
        """Number of different values that are kept: what the memory goes by."""
        return len(self._counts)

    def percentile_ns(self, percent: float) -> int:
        """The smallest kept value with at least this part of all at or below it; 0 if there is none."""
        wanted, seen = len(self) * percent / 100, 0
        for value, count in sorted(self._counts.items()):
            seen += count
            if seen >= wanted:
                return value
        return 0

    def state(self) -> Snapshot:
        """All counts, as numbers in memory have them: a list of thousands would cost the tick milliseconds."""
        counted = self._counts
        values = np.fromiter(counted, np.int64, len(counted))
        counts = np.fromiter(counted.values(), np.int64, len(counted))
        return {"values": values.tobytes(), "counts": counts.tobytes(), "max_ns": self.max_ns}

    def restore(self, saved: Snapshot) -> None:
        """Count on from there."""
        values, counts = (np.frombuffer(saved[name], np.int64).tolist() for name in ("values", "counts"))
        self._waiting.clear()
        self._counted = Counter(dict(zip(values, counts, strict=True)))
        self._longest_ns = int(saved["max_ns"])

    def spread_us(self) -> dict[str, float]:
        """Median and 99th percentile, us."""
        return {"p50": self.percentile_ns(50) / 1e3, "p99": self.percentile_ns(99) / 1e3}
