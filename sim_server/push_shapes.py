"""How a push goes over time: a wrench [force; torque] for the time since it began. Decided by the scenario's seed."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sim_server.faults.pushes import Push
from sim_server.layout import Array

Wave = Callable[[float], Array]
"""Wrench at a time since the push began, (6,) N and N m, world axes. Ask in order of time."""

STREAM = 0x9054
"""Keeps these draws apart from those of noise, of plant differences and of bad grasps."""
SINES = ((1.0, 0.5), (1.7, 0.3), (2.9, 0.2))
"""Frequencies of a smooth push over that of its slowest sine, and their weights, whose sum is one: together they never
exceed the amplitude, and as the ratios are no small fractions they do not repeat for long."""
PERIOD_S, HOLD_S = 4.0, 0.5
FADE_S = 0.5
"""A smooth push comes and goes in this time, or in a quarter of its own if that is shorter."""


def wave_of(push: Push, seed: int, number: int) -> Wave:
    """How this push goes. ``number``: of the push in its run; each draws from a stream of its own."""
    amplitude = np.array([*push.force_N, *push.torque_Nm])
    rng = np.random.default_rng([seed, STREAM, number])
    if push.shape == "smooth":
        phases = rng.uniform(0.0, 2.0 * math.pi, (len(SINES), 6))
        return smooth(amplitude, push.period_s or PERIOD_S, push.for_s, phases)
    if push.shape == "abrupt":
        return abrupt(amplitude, push.hold_s or HOLD_S, rng)
    return lambda elapsed_s: amplitude


def smooth(amplitude: Array, period_s: float, for_s: float, phases: Array) -> Wave:
    """Component i at time t: fade(t) a_i sum over k of w_k sin(2 pi r_k t / period + phase_ki).

    Args:
        amplitude: a, (6,), bound of each component.
        phases: (sines, 6) rad.
    """
    ratios, weights = np.array(SINES).T
    rates = 2.0 * math.pi * ratios[:, None] / period_s

    def at(elapsed_s: float) -> Array:
        swing = weights @ np.sin(rates * elapsed_s + phases)
        here: Array = fade(elapsed_s, for_s) * amplitude * swing
        return here

    return at


def fade(elapsed_s: float, for_s: float) -> float:
    """From 0 at the start to 1 and back to 0 at the end, without a jump or a kink."""
    share = min(elapsed_s, for_s - elapsed_s) / min(FADE_S, for_s / 4)
    s = min(max(share, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


def abrupt(amplitude: Array, hold_s: float, rng: np.random.Generator) -> Wave:
    """Every component jumps to a value drawn evenly within its amplitude, and stays there until the next jump. Times
    between jumps are drawn from the exponential distribution: nothing tells when the next one comes."""
    return _Jumps(amplitude, hold_s, rng)


class _Jumps:
    def __init__(self, amplitude: Array, hold_s: float, rng: np.random.Generator) -> None:
        self._amplitude, self._hold_s, self._rng = amplitude, hold_s, rng
        self._until_s, self._here = 0.0, np.zeros(6)

    def __call__(self, elapsed_s: float) -> Array:
        while elapsed_s >= self._until_s:
            self._until_s += self._rng.exponential(self._hold_s)
            self._here = self._amplitude * self._rng.uniform(-1.0, 1.0, 6)
        return self._here
