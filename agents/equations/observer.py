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


def observer_gain(rate: float, leak: float) -> float:
    """What the observer tells of a torque that stays, 1: rate / (rate + leak).

    An arm that gives back this part of what it feels is as stiff for slow loads as its spring over one minus it.
    """
    return rate / (rate + leak)


def leaky_observer(r: Array, tau_ext: Array, gain: float, keep: Any) -> Array:
    """The observed external torque one step on, (n,) N m: keep r + (1 - keep) gain tau_ext.

    The exact solution of rdot = rate (tau_ext - r) - leak r over a step in which tau_ext is constant, so it does not
    depend on how the steps are cut. Without the leak, arms on one body that differ by a hair would wind up against each
    other for ever; with it their forces settle.

    Args:
        r: observed until now, (n,) N m.
        tau_ext: mean external torque of this step, (n,) N m: the change of momentum over dt, less
            :func:`momentum_rate`.
        gain: :func:`observer_gain`.
        keep: exp(-(rate + leak) dt).
    """
    return keep * r + (1.0 - keep) * gain * tau_ext
