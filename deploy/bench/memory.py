"""What each process of a carry holds in memory."""

from __future__ import annotations

import statistics
from collections.abc import Callable

from deploy.bench.carry import carry
from deploy.bench.figures import Part, Samples
from deploy.bench.plan import Plan, arms_text, team_of
from deploy.bench.process_cost import Memory

NO_PSS = "PSS is left out: the kernel does not tell it of processes that we may not trace."
NO_PROC = "Memory is left out: only Linux tells it (/proc)."


def measure_memory(plan: Plan, tell: Callable[[str], None]) -> Part:
    """RSS and PSS in the middle of a carry: the simulator, a follower (mean of the team), the leader, all together."""
    samples, said = Samples(), set[str]()
    for k in range(plan.turns):
        tell(f"turn {k + 1} of {plan.turns}")
        found = dict(carry(team_of(plan.team), plan.seconds).memory)
        if not found:
            said.add(NO_PROC)
            continue
        followers = [memory for name, memory in found.items() if name not in ("sim", "leader")]
        rows = {"simulator": [found["sim"]], "a follower": followers, "leader": [found["leader"]]}
        for row, memories in rows.items():
            _add(samples, row, arms_text(plan.team), memories, statistics.fmean)
        _add(samples, "all processes", arms_text(plan.team), list(found.values()), sum)
        if any(memory.pss_MB is None for memory in found.values()):
            said.add(NO_PSS)
    return Part(
        "memory",
        "Memory in mid-carry",
        samples.figures(),
        (*sorted(said), "PSS: pages that several processes share are divided among them; only its sum is a sum."),
    )


def _add(
    samples: Samples, row: str, column: str, memories: list[Memory], together: Callable[[list[float]], float]
) -> None:
    samples.add(f"{row}, RSS", column, "MB", together([memory.rss_MB for memory in memories]), "less")
    pss = [memory.pss_MB for memory in memories if memory.pss_MB is not None]
    if len(pss) == len(memories):
        samples.add(f"{row}, PSS", column, "MB", together(pss), "less")
