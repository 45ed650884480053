"""Section IV-D's other input: the base is driven by the force at the wrist, low-passed, instead of by displacement.

What is read, and why so:

* The estimate begins at zero and comes up within the filter's time, so that the base is not jerked at take-over.
* No bias is taken at take-over. What the wrist carries in the plane then is either the leader's pull (of an arm that
  comes back, or joins) or what the grasps press against each other. To subtract the first would make the arm deaf to
  the leader for good; the second a base may follow: that moves it until the grasp is at ease.
* The arm gets a planar spring of k_env, which ties force and displacement to each other. Without it a base that follows
  force alone keeps no distance to its hand, and what is left of noise and friction carries it away for good; with it
  a wrong force f moves it by f / k_env, and no further.
"""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from agents.equations.wrist import displacement_of_force

Array = NDArray[np.float64]


class WristInput:
    """The displacement that the load's planar pull stands for, and its rate.

    The pull is the rate of the hand's momentum p less the wrist's force f. A rate of what is measured with noise is
    taken together with the low-pass of time constant T: F = p / T + s, where s follows -f - p / T.
    """

    def __init__(self, k_env_N_m: float, filter_s: float) -> None:
        self._k_env, self._filter_s = k_env_N_m, filter_s
        self._state: Array | None = None

    def step(self, force: Array, momentum: Array, dt_s: float) -> tuple[Array, Array]:
        """e, (2,) m, and its rate, (2,) m/s, in B, without the rate of what accelerates the hand.

        Args:
            force: of the arm on the hand in the plane, (2,) N in B.
            momentum: of the hand in the plane, (2,) kg m/s in B.
        """
        by_rate = momentum / self._filter_s
        if self._state is None:
            self._state = -by_rate
        wanted = -force - by_rate
        self._state = self._state + (1.0 - exp(-dt_s / self._filter_s)) * (wanted - self._state)
        rate = (wanted - self._state) / self._filter_s
        return displacement_of_force(by_rate + self._state, self._k_env), displacement_of_force(rate, self._k_env)
