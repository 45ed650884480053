"""Sensor noise: one stream of random numbers per arm, so that no arm's noise tells of any other, or of how many."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim_server.snapshot import Snapshot, SnapshotError, random_state, set_random_state

Array = NDArray[np.float64]

STREAM = 1
"""Keeps these draws apart from other streams of the same seed (:mod:`sim_server.differences` is stream 2)."""
TICKS_AHEAD = 256
"""Drawn at once: one call for many ticks."""


class SensorNoise:
    """Noise of N arms with k channels each, tick by tick.

    Args:
        sigma: standard deviation of each channel, (k,).
        seed: the scenario's.
        arms: N.
    """

    def __init__(self, sigma: Array, seed: int, arms: int) -> None:
        self._sigma, self._seed = sigma, seed
        self._streams = [np.random.default_rng([seed, STREAM, arm]) for arm in range(arms)]
        self._drawn: Array = np.empty((TICKS_AHEAD, arms, len(sigma)))
        self._next = TICKS_AHEAD
        self._before = [random_state(stream) for stream in self._streams]
        """Where the streams stood before what is drawn now: so a snapshot need not hold the numbers themselves."""

    def exchange(self, rows: Sequence[int | None], numbers: Sequence[int]) -> None:
        """From now on these arms: each is an old row, or new and the arm of that number."""
        streams, before, drawn = [], [], np.empty((TICKS_AHEAD, len(rows), len(self._sigma)))
        for here, (row, number) in enumerate(zip(rows, numbers, strict=True)):
            stream = np.random.default_rng([self._seed, STREAM, number]) if row is None else self._streams[row]
            streams.append(stream)
            before.append(random_state(stream) if row is None else self._before[row])
            drawn[:, here] = self._block(stream) if row is None else self._drawn[:, row]
        self._streams, self._before, self._drawn = streams, before, drawn

    def _block(self, stream: np.random.Generator) -> Array:
        block: Array = self._sigma * stream.standard_normal((TICKS_AHEAD, len(self._sigma)))
        return block

    def draw(self) -> Array:
        """The next tick's noise, (N, k); valid until the next call."""
        if self._next == TICKS_AHEAD:
            self._draw_ahead()
            self._next = 0
        self._next += 1
        drawn: Array = self._drawn[self._next - 1]
        return drawn

    def _draw_ahead(self) -> None:
        self._before = [random_state(stream) for stream in self._streams]
        for arm, stream in enumerate(self._streams):
            self._drawn[:, arm] = self._block(stream)

    def state(self) -> Snapshot:
        """Where the streams stood when the present numbers were drawn, and how many of those are used up."""
        if self._next == TICKS_AHEAD:
            return {"streams": [random_state(stream) for stream in self._streams], "next": self._next}
        return {"streams": self._before, "next": self._next}

    def restore(self, saved: Snapshot) -> None:
        """Go on from there: the next draw gives what it would have given."""
        following = int(saved["next"])
        if not 0 <= following <= TICKS_AHEAD:
            raise SnapshotError(f"noise: next: got {following}, expected 0 to {TICKS_AHEAD}")
        for stream, state in zip(self._streams, saved["streams"], strict=True):
            set_random_state(stream, state)
        if following < TICKS_AHEAD:
            self._draw_ahead()
        self._next = following
