"""The model of docs/scale.md: ``python benchmarks/scale.py FILE [ROUND_TRIP_US]``, FILE of ``bench growth --out``.

Prints the model beside what was measured on that machine, and what it predicts with the simulator on a machine of its
own and the followers on 1, 2, 4 ... others of the same kind. Measured is the first table alone.
"""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from deploy.bench.figures import read_file
from deploy.bench.growth import costs_in, tick_us, tick_us_apart

MACHINES = (1, 2, 4, 8)


def main(file: Path, round_trip_us: float) -> None:
    """Print both tables."""
    machine, parts = read_file(file)
    cores, costs, console = int(machine["cores"]), costs_in(parts["growth"]), Console()
    found = Table(
        "arms", "measured, ticks/s", "model, ticks/s", "model / measured", title=f"one machine, {cores} cores"
    )
    apart = Table("arms", *(f"{count} + simulator's" for count in MACHINES), title="predicted, ticks/s, by machines")
    waking_us = costs[0].tick - tick_us(costs[0], cores)
    for cost in costs:
        model = tick_us(cost, cores, waking_us)
        found.add_row(str(cost.arms), f"{1e6 / cost.tick:.0f}", f"{1e6 / model:.0f}", f"{cost.tick / model:.2f}")
        rates = (1e6 / tick_us_apart(cost, cores, count, waking_us + round_trip_us) for count in MACHINES)
        apart.add_row(str(cost.arms), *(f"{rate:.0f}" for rate in rates))
    console.print(found)
    console.print(apart)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 200.0)
