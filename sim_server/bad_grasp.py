"""A grasp that fails: soft, with spurious forces between hand and load. The paper's third demonstration begins so."""

from __future__ import annotations

import math

import numpy as np

from sim_server.layout import Array
from sim_server.scenario import arm_number
from sim_server.snapshot import Snapshot, fill, random_state, set_random_state
from sim_server.world import World

SOFT_SOLREF, SOFT_SOLIMP = (0.05, 1.0), (0.5, 0.8, 0.005, 0.5, 2.0)
"""A hand that holds badly: a weld ten times as slow as a good one, which gives by millimetres."""
FORCE_MEMORY_S = 0.05
"""Correlation time of the spurious force: a hand that slips jerks, it does not hiss."""
STREAM = 0x51195
"""Keeps these draws apart from those of noise and of plant differences."""


class BadGrasp:
    """One hand that holds badly.

    Args:
        world: its weld becomes soft now.
        arm: whose hand.
        force_N: one standard deviation of the spurious force, per axis.
    """

    def __init__(self, world: World, arm: str, force_N: float) -> None:
        self._world, self._ids = world, world.arms[arm]
        self._rng = np.random.default_rng([world.scenario.seed, STREAM, arm_number(arm)])
        self._sigma, self._force = force_N, np.zeros(3)
        model, weld = world.model, self._ids.weld
        self._good = model.eq_solref[weld].copy(), model.eq_solimp[weld].copy()
        world.model.eq_solref[self._ids.weld] = SOFT_SOLREF
        world.model.eq_solimp[self._ids.weld] = SOFT_SOLIMP

    def move_to(self, world: World) -> None:
        """The world has other robots now; this hand goes on holding badly."""
        self._world, self._ids = world, world.arms[self._ids.name]

    def push(self, dt_s: float) -> Array:
        """Add this step's spurious force to the load at the grasp, and its opposite to the hand; the force, (3,) N.

        Call after the other forces on both are written: this adds to them.
        """
        keep = math.exp(-dt_s / FORCE_MEMORY_S)
        self._force *= keep
        self._force += self._sigma * math.sqrt(1.0 - keep * keep) * self._rng.standard_normal(3)
        data, ids = self._world.data, self._ids
        point = data.site_xpos[ids.grasp_site]
        load, hand = self._world.load_body, ids.hand_body
        data.xfrc_applied[load, :3] += self._force
        data.xfrc_applied[load, 3:] += np.cross(point - data.xipos[load], self._force)
        data.xfrc_applied[hand, :3] -= self._force
        data.xfrc_applied[hand, 3:] -= np.cross(point - data.xipos[hand], self._force)
        return self._force

    def end(self) -> None:
        """No force any more, and a good grasp the next time; the weld is the plant's to open."""
        model, weld = self._world.model, self._ids.weld
        model.eq_solref[weld], model.eq_solimp[weld] = self._good
        self._world.data.xfrc_applied[self._ids.hand_body] = 0.0

    def state(self) -> Snapshot:
        """The size of the force, the force now, and where its stream stands."""
        return {"force_N": self._sigma, "force": self._force, "stream": random_state(self._rng)}

    def restore(self, saved: Snapshot) -> None:
        """Go on from there; ``force_N`` was the constructor's."""
        fill(self._force, saved["force"])
        set_random_state(self._rng, saved["stream"])
