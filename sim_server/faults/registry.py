"""All faults there are: the one list from which scenarios, docs/chaos.md and their tests take them."""

from __future__ import annotations

from sim_server.faults import delays, grasps, losses, processes, pushes, spoiled
from sim_server.faults.event import Fault

FAULTS: tuple[Fault, ...] = (
    *processes.FAULTS,
    *delays.FAULTS,
    *losses.FAULTS,
    *spoiled.FAULTS,
    *grasps.FAULTS,
    *pushes.FAULTS,
)
