"""A predefined trajectory of the task (section VI-B): how it swings over time, with two derivatives, and how it tilts.

Numbers or symbols (agents/tracing.py) alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def ramp_share(time_s: float, ramp_s: float) -> float:
    """How much of the ramp is over, 0 to 1; a number, since symbols cannot choose."""
    return min(time_s / ramp_s, 1.0) if ramp_s else 1.0


def sine_reference(frequency_Hz: float, ramp_s: float, time_s: Any, share: Any) -> tuple[Any, Any, Any]:
    """Swing of the reference between -1 and 1 and its two derivatives: s(share) sin(2 pi f t).

    The ramp s = u^3 (10 - 15 u + 6 u^2) goes from 0 to 1 with two derivatives that are zero at both ends, so that
    position, velocity and acceleration begin at rest, and nothing jumps. x_d, xd_d and xdd_d of paper eq. 6 are these
    times the amplitudes of height, roll and pitch.

    Args:
        time_s: since take-over, not negative.
        share: :func:`ramp_share` of it.
    """
    w = 2.0 * np.pi * frequency_Hz
    sine, sine_d = np.sin(w * time_s), w * np.cos(w * time_s)
    sine_dd = -(w * w) * sine
    if not ramp_s:
        return sine, sine_d, sine_dd
    u = share
    s = u * u * u * (10.0 - u * (15.0 - 6.0 * u))
    s_d = u * u * (30.0 - u * (60.0 - 30.0 * u)) / ramp_s
    s_dd = u * (60.0 - u * (180.0 - 120.0 * u)) / (ramp_s * ramp_s)
    return s * sine, s_d * sine + s * sine_d, s_dd * sine + 2.0 * s_d * sine_d + s * sine_dd


def tilted_axis(roll: float, pitch: float, swing: Any) -> Array:
    """The upright axis turned by the rotation vector swing (roll, pitch, 0) rad, (3,) unit vector in B.

    Its angular velocity is exactly the swing's rate times (roll, pitch, 0): the task velocity that goes with it.
    """
    amplitude = float(np.hypot(roll, pitch))
    if not amplitude:
        return np.array([0.0, 0.0, 1.0])
    sine = np.sin(amplitude * swing)
    return np.array([pitch / amplitude * sine, -roll / amplitude * sine, np.cos(amplitude * swing)])
