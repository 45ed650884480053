"""The parts of the bench by name, and how they are run one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from deploy.bench.controller import measure_controller
from deploy.bench.figures import Part
from deploy.bench.growth import measure_growth
from deploy.bench.lock_step import measure_lock_step
from deploy.bench.memory import measure_memory
from deploy.bench.physics import measure_physics
from deploy.bench.plan import Plan
from deploy.bench.real_time import measure_real_time
from deploy.bench.start_up import measure_start_up
from deploy.bench.watching import measure_watching

Tell = Callable[[str], None]
"""Says what goes on."""

PARTS: Mapping[str, Callable[[Plan, Tell], Part]] = {
    "controller": measure_controller,
    "physics": measure_physics,
    "lock-step": measure_lock_step,
    "growth": measure_growth,
    "real-time": measure_real_time,
    "start-up": measure_start_up,
    "memory": measure_memory,
    "watching": measure_watching,
}
"""In the order in which they run: what needs no other process first."""


def run_parts(names: Sequence[str], plan: Plan, tell: Tell) -> Iterator[Part]:
    """Each part as soon as it is done.

    Raises:
        RigFailed, CarryFailed: something that was to be measured did not come about.
    """
    for name in names:
        start = time.monotonic()
        part = PARTS[name](plan, lambda what, name=name: tell(f"{name}: {what}"))  # type: ignore[misc]  # cannot infer a lambda with defaults
        yield replace(part, wall_s=time.monotonic() - start)
