"""Wall times of a run as counts of rounded values: a run of any length takes no more memory than a short one."""

from __future__ import annotations

from collections import Counter

import numpy as np

from sim_server.snapshot import Snapshot

KEPT_BITS = 8
"""Leading binary digits that a duration keeps, so that it is rounded down by less than 1 %."""


class Durations:
    """How often each duration was seen. At most 128 values are told apart per doubling."""

    __slots__ = ("_counts", "max_ns")

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self.max_ns = 0
        """The longest, not rounded."""

    def append(self, ns: int) -> None:
        """Count one."""
        shift = max(0, ns.bit_length() - KEPT_BITS)
        self._counts[ns >> shift << shift] += 1
        if ns > self.max_ns:
            self.max_ns = ns

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
        many = len(self._counts)
        values = np.fromiter(self._counts, np.int64, many)
        counts = np.fromiter(self._counts.values(), np.int64, many)
        return {"values": values.tobytes(), "counts": counts.tobytes(), "max_ns": self.max_ns}

    def restore(self, saved: Snapshot) -> None:
        """Count on from there."""
        values, counts = (np.frombuffer(saved[name], np.int64).tolist() for name in ("values", "counts"))
        self._counts = Counter(dict(zip(values, counts, strict=True)))
        self.max_ns = int(saved["max_ns"])

    def spread_us(self) -> dict[str, float]:
        """Median and 99th percentile, us."""
        return {"p50": self.percentile_ns(50) / 1e3, "p99": self.percentile_ns(99) / 1e3}
