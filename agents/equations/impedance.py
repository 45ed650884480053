"""Springs and dampers of the hand in its own directions, brought to the joints by the transposed Jacobian. (Ours.)

A force on the hand through J^T is that force and nothing else: what lifts does not push sideways. No inertia is shaped,
so spring and damper take power up whatever the load and however wrong the model.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.equations.bounds import limited

Array = NDArray[np.float64]


def stiffening(K_least: Array, K_most: Array, x_err: Array, x_soft: Array) -> Array:
    """Wanted stiffness of each direction, (m,): K_least + (K_most - K_least) s / (1 + s) with s = (x_err / x_soft)^2.

    The idea of the paper's eq. 15, stiffer with the square of the error, in the directions in which the load is felt
    instead of joint by joint; and with an end.

    Args:
        K_least, K_most: without an error, and with an endless one; (m,) N/m, N m/rad.
        x_err: (m,) m, rad.
        x_soft: error at which half the way is gone, (m,) m, rad.
    """
    s = (x_err / x_soft) ** 2
    return K_least + (K_most - K_least) * (s / (1.0 + s))


def stiffness_step(K: Array, wanted: Array, rise: Any) -> Array:
    """Stiffness one step on, (m,): ``wanted``, but between K / rise and K rise. ``rise``: exp(rate dt).

    With its relative rate bounded, a spring that stiffens gives no more than its damper takes: see
    :func:`stability_margin`.
    """
    K_next: Array = limited(wanted, K / rise, K * rise)
    return K_next


def stability_margin(K: Array, K_rate: Array, D: Array, D_rate: Array, alpha: float) -> Array:
    """Kronander and Billard 2016 (Stability considerations for variable impedance control), theorem 1, direction
    by direction, (m,): 2 alpha K - K_rate - alpha D_rate. Not negative: the hand comes to rest.

    Args:
        K, K_rate: N/m, N/(m s).
        D, D_rate: N s/m, N/m.
        alpha: 1/s, at most D over the inertia, the load's share included.
    """
    return 2.0 * alpha * K - K_rate - alpha * D_rate


def damping(K: Array, Lambda: Array, zeta: float) -> Array:
    """Damping that goes with the stiffness, (m,): 2 zeta sqrt(K_i Lambda_ii).

    Args:
        K: stiffness, (m,) N/m, N m/rad.
        Lambda: inertia in these directions, (m, m).
        zeta: damping ratio of the free arm.
    """
    D: Array = np.sqrt(K * np.diag(Lambda)) * (2.0 * zeta)
    return D


def spring_force(K: Array, x_err: Array, D: Array, xd: Array) -> Array:
    """Force of spring and damper, (m,) N, N m: K x_err - D xd."""
    return K * x_err - D * xd


def stiffness_power(K_rate: Array, x_err: Array) -> Any:
    """Power that a changing stiffness puts into its spring, W: half of sum K_rate_i x_err_i^2."""
    return (K_rate @ (x_err * x_err)) * 0.5


def damping_power(D: Array, xd: Array) -> Any:
    """Power that the damper takes up, W: sum D_i xd_i^2."""
    return D @ (xd * xd)
