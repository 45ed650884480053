"""Wall times of small functions, called in turns so that all of them meet the same weather."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from deploy.bench.figures import percentile

WARM_PART = 10
"""Of the calls, a tenth more is made first and not counted."""
CHUNK = 50
"""Calls of one function before it is the next one's turn: few enough that all share a moment, and enough to be warm."""

Action = Callable[[], Any]


def times_us(actions: Mapping[str, Action], calls: int) -> dict[str, list[float]]:
    """Wall time of every call of every action, us, ``calls`` each, in turns of :data:`CHUNK` calls.

    Each chunk begins with a few calls that are not counted, since what ran before has the caches.
    """
    found: dict[str, list[float]] = {name: [] for name in actions}
    for action in actions.values():
        for _ in range(calls // WARM_PART + 1):
            action()
    clock = time.perf_counter_ns
    while any(len(times) < calls for times in found.values()):
        for name, action in actions.items():
            times = found[name]
            for _ in range(CHUNK // WARM_PART):
                action()
            for _ in range(min(CHUNK, calls - len(times))):
                start = clock()
                action()
                times.append((clock() - start) / 1e3)
    return found


def spread_us(times: list[float]) -> tuple[float, float]:
    """Median and 99th percentile, us."""
    return percentile(times, 50), percentile(times, 99)
