"""How hard a leader pulls: in the plane, never above its bound, whatever is asked of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agents.wish import Wish

Array = NDArray[np.float64]


def shortened(force: Array, force_max: float) -> Array:
    """The force itself, (2,) N, or one of the same direction that is no longer than force_max, N."""
    size = float(np.linalg.norm(force))
    # A hair below the bound: rounding of the shortened vector must not put its length above.
    return force if size <= force_max else force * (force_max / size * (1.0 - 1e-12))


def bounded_pull(goal_error: Array, velocity: Array, stiffness: float, damping: float, force_max: float) -> Array:
    """Pull in the plane, (2,) N: stiffness * goal_error - damping * velocity, shortened to force_max.

    Section V of the paper: a lateral force, bounded at 40 N, in the direction of the target, in proportion to the
    distance. The damping is ours: without it the load overshoots and turns round its own pull.

    Args:
        goal_error: goal minus the load's place, (2,) m, world.
        velocity: of the point that is pulled, (2,) m/s, world.
        stiffness: N/m.
        damping: N s/m.
        force_max: N.
    """
    return shortened(stiffness * goal_error - damping * velocity, force_max)


def wished_pull(wish: Wish, velocity: Array, damping: float, force_max: float) -> Array:
    """What a person wants, as a pull in the plane, (2,) N: a share of force_max, or -damping * velocity to brake.

    Args:
        wish: of the person.
        velocity: of the point that is pulled, (2,) m/s, world.
        damping: N s/m.
        force_max: N.
    """
    if wish.brake:
        return shortened(-damping * velocity, force_max)
    return shortened(force_max * np.array(wish.share), force_max)


def rotate(quat_wxyz: Array, v: Array) -> Array:
    """The vector v, (3,), turned by the unit quaternion (w, x, y, z)."""
    w, r = quat_wxyz[0], quat_wxyz[1:]
    return v + 2.0 * np.cross(r, np.cross(r, v) + w * v)
