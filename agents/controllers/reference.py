"""Which trajectory of the task a follower is to go along: its keys among a law's gains, and where it is at a time."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from agents.equations.reference import ramp_share, sine_reference, tilted_axis

Array = NDArray[np.float64]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class ReferenceGains(BaseModel):
    """Section VI-B: the desired task, relative to where it is held. A plot computes it again from these and time."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    reference: Literal["none", "sine"] = "none"
    """``none``: the task stays where it is held."""
    reference_height_m: Finite = 0.1
    """``sine``: amplitudes"""
    reference_roll_rad: Finite = 0.0
    reference_pitch_rad: Finite = 0.0
    reference_frequency_Hz: Positive = 0.25
    reference_ramp_s: NotNegative = 4.0
    """``sine``: time in which it comes to its full amplitude."""

    def reference_at(self, time_s: float) -> tuple[Array, Array, Array]:
        """x_d, xd_d, xdd_d of (height m, roll rad, pitch rad) relative to where the task is held, (3,) each, this long
        after take-over."""
        if self.reference == "none":
            return np.zeros(3), np.zeros(3), np.zeros(3)
        x_d, xd_d, xdd_d, _ = self.desired(time_s, ramp_share(time_s, self.reference_ramp_s))
        return x_d, xd_d, xdd_d

    def desired(self, time_s: Any, share: Any) -> tuple[Array, Array, Array, Array]:
        """The same and the axis that shall be the hand's vertical one, (3,) in B, for numbers or symbols.

        Args:
            share: :func:`agents.equations.reference.ramp_share` of the time.
        """
        swing, rate, acceleration = sine_reference(self.reference_frequency_Hz, self.reference_ramp_s, time_s, share)
        amplitude = np.array([self.reference_height_m, self.reference_roll_rad, self.reference_pitch_rad])
        up_d = tilted_axis(self.reference_roll_rad, self.reference_pitch_rad, swing)
        return amplitude * swing, amplitude * rate, amplitude * acceleration, up_d


class ReferenceTime:
    """Where on the reference a law is: its input ``when``, time since take-over and the share of the ramp."""

    shape = (2,)

    def __init__(self, gains: ReferenceGains) -> None:
        self._elapsed_s, self._ramp_s = 0.0, gains.reference_ramp_s
        self._has_begun = False

    def write(self, when: Array, dt_s: float) -> None:
        """Into ``when``, (2,), for this step: 0 at the first, and ``dt_s`` later at each that follows."""
        if self._has_begun:
            self._elapsed_s += dt_s
        self._has_begun = True
        when[0], when[1] = self._elapsed_s, ramp_share(self._elapsed_s, self._ramp_s)  # numpy takes longer over a tuple
