"""What a row of the trace is: a name and a width for every column. An observer needs it, and no Parquet.

Columns: ``tick``, ``time_s``, ``load.position`` (3), ``load.quat_wxyz`` (4), ``load.linear_velocity`` (3),
``load.angular_velocity`` (3), ``leader.force`` (3), ``load.disturbance`` (6: force and torque about the centre of mass,
world), and for every arm ``a1.q`` (n), ``a1.qd`` (n), ``a1.tau`` (n, applied), ``a1.wrench`` (6), ``a1.stiffness`` (n)
and ``a1.passivity_residual`` (W), both as its agent reports them, ``a1.base`` (3: x, y, yaw in the world),
``a1.base_velocity`` (3), ``a1.base_force`` (3, applied, frame B), ``a1.grip`` (6: what the hand exerts on the load at
the grasp, world), ``a1.disturbance`` (6: force and torque on the hand at the tool centre, world) and ``a1.age_ticks``.
Where an arm took no part its numbers are NaN and its age is null. A disturbance is what comes from outside (a push) or
from a grasp that fails, as it was applied in the tick's last physics step; the leader's pull is none.
"""

from __future__ import annotations

from collections.abc import Iterable


def columns(arms: Iterable[str], joints: int) -> dict[str, int]:
    """Name and width of every column, in order."""
    named = {
        "tick": 1,
        "time_s": 1,
        "load.position": 3,
        "load.quat_wxyz": 4,
        "load.linear_velocity": 3,
        "load.angular_velocity": 3,
        "leader.force": 3,
        "load.disturbance": 6,
    }
    for arm in arms:
        named |= {
            f"{arm}.q": joints,
            f"{arm}.qd": joints,
            f"{arm}.tau": joints,
            f"{arm}.wrench": 6,
            f"{arm}.stiffness": joints,
            f"{arm}.passivity_residual": 1,
            f"{arm}.base": 3,
            f"{arm}.base_velocity": 3,
            f"{arm}.base_force": 3,
            f"{arm}.grip": 6,
            f"{arm}.disturbance": 6,
            f"{arm}.age_ticks": 1,
        }
    return named
