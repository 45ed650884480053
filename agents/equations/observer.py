"""What the arm feels beyond its own model: a leaky observer of generalised momentum, in place of eq. 10. (Ours.)

M qdd + C qd + g = tau + tau_ext gives, with Mdot = C + C^T, the rate of the momentum p = M qd:

    pdot = tau + C^T qd - g + tau_ext

so what the momentum does beyond the model is the external torque, with no acceleration measured (De Luca and Mattone
2005, Sensorless robot collision detection and hybrid force/motion control).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def momentum_rate(tau: Array, C: Array, qd: Array, g: Array) -> Array:
    """Rate of the generalised momentum by the arm's own model, (n,) N m: tau + C^T qd - g.

    Args:
        tau: measured joint torques, (n,) N m.
        C: Coriolis matrix with Mdot = C + C^T, (n, n).
    """
    return tau + C.T @ qd - g


def felt_torque(p: Array, p_before: Array, model_rate: Array, dt_s: Any) -> Array:
    """Mean external torque since the step before, (n,) N m: (p - p_before) / dt - :func:`momentum_rate`.

    As noisy as the velocities over dt; summed up by an observer, only the noise of the last velocity is left.
    """
    felt: Array = (p - p_before) / dt_s - model_rate
    return felt


def leaky(memory: Array, new: Array, gain: float, keep: Any) -> Array:
    """A leaky observer's memory one step on: keep memory + (1 - keep) gain new.

    The exact solution of ydot = rate (new - y) - leak y over a step in which ``new`` is constant, with gain = rate /
    (rate + leak) and keep = exp(-(rate + leak) dt); so it does not depend on how the time is cut into steps. For an
    error that the memory itself acts on, ydot = rate new - leak y: gain = rate / leak and keep = exp(-leak dt).

    Arms on one body that differ by a hair would without the leak wind up against each other for ever; with it their
    forces settle.
    """
    updated: Array = memory * keep + new * (1.0 - keep) * gain
    return updated
