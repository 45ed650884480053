"""All faults there are: the one list from which scenarios, docs/chaos.md and their tests take them."""

from __future__ import annotations

from sim_server.faults import added_mass, delays, grasps, joints, losses, processes, pushes, sensors, spoiled, wheels
from sim_server.faults.event import Fault

FAULTS: tuple[Fault, ...] = (
    *processes.FAULTS,
    *delays.FAULTS,
    *losses.FAULTS,
    *spoiled.FAULTS,
    *joints.FAULTS,
    *sensors.FAULTS,
    *wheels.FAULTS,
    *grasps.FAULTS,
    *pushes.FAULTS,
    *added_mass.FAULTS,
)
