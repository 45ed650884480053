"""What each hand exerts on the load, read exactly from the forces of its grasp."""

from __future__ import annotations

import numpy as np

from sim_server.layout import Array
from sim_server.scene import constraint_columns
from sim_server.world import World

WELD_ROWS = 6
"""Constraint rows of one weld: three of position, three of rotation, next to each other."""


def grip_wrenches(world: World) -> Array:
    """Wrenches ``F_G_W`` that the hands exert on the load, (N, 6) [N, N m], in the order of ``world.arms``.

    Each is [force; torque] at that arm's grasp point G (its strut's), in the world's axes, at the state that the last
    step started from, as ``data.xpos`` is. Zeros for a hand that does not hold.

    From the constraint forces f of the welds, weld by weld: J^T f on the load's free joint, whose three rotations are
    in O's axes and about O; then moved to G.
    """
    data = world.data
    arms = list(world.arms.values())
    wrenches = np.zeros((len(arms), 6))
    rows = data.ne  # equality constraints come first, and all of them are welds
    if not rows:
        return wrenches
    assert rows % WELD_ROWS == 0, rows
    by_row = constraint_columns(world.model, data, world.load_dof)[:rows] * data.efc_force[:rows, None]
    held = {int(weld): k for k, weld in enumerate(data.efc_id[:rows:WELD_ROWS])}
    on_load = by_row.reshape(-1, WELD_ROWS, 6).sum(axis=1)
    holding = [(row, held[ids.weld], ids.grasp_site) for row, ids in enumerate(arms) if ids.weld in held]
    places, welds, sites = (list(column) for column in zip(*holding, strict=True))
    force = on_load[welds, :3]
    lever = data.site_xpos[sites] - data.xpos[world.load_body]
    R_WO = data.xmat[world.load_body].reshape(3, 3)
    wrenches[places, :3] = force
    wrenches[places, 3:] = on_load[welds, 3:] @ R_WO.T - _cross(lever, force)
    return wrenches


def _cross(a: Array, b: Array) -> Array:
    """a x b, row by row, (N, 3); numpy's own costs several times as much for short arrays."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
