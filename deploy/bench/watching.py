"""What it costs to be watched: the recorder, and the audit's count of what every connection carries."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

from deploy.bench.carry import RECORD_EVERY_MS, carry
from deploy.bench.figures import Part, Samples
from deploy.bench.plan import Plan, arms_text, team_of

PLAIN, RECORDED, UNCOUNTED = "audited, not recorded", "audited, recorded at 100 Hz", "neither"
NO_RECORDER = "Recording is left out: rerun is not installed; expected the extra `view`: pip install 'palanquin[view]'"


def can_record() -> bool:
    """Whether what records is installed."""
    return find_spec("rerun") is not None


def measure_watching(plan: Plan, tell: Callable[[str], None]) -> Part:
    """Ticks a second with and without, in turns whose order goes round."""
    samples, column = Samples(), arms_text(plan.team)
    kinds = [PLAIN, UNCOUNTED, *([RECORDED] if can_record() else [])]
    for k in range(plan.turns):
        found: dict[str, float] = {}
        for step in range(len(kinds)):
            kind = kinds[(k + step) % len(kinds)]
            tell(f"turn {k + 1} of {plan.turns}, {kind}")
            found[kind] = carry(
                team_of(plan.team),
                plan.seconds,
                {"record": {"every_ticks": RECORD_EVERY_MS}},
                recorded=kind == RECORDED,
                audited=kind != UNCOUNTED,
            ).ticks_per_s
        for kind in kinds:
            samples.add(kind, column, "ticks/s", found[kind], "more")
        samples.ratio("audited / not", column, found[PLAIN], found[UNCOUNTED], "more")
        if RECORDED in found:
            samples.ratio("recorded / not", column, found[RECORDED], found[PLAIN], "more")
    said = ("Without the audit the simulator does not count what every connection carries; its last look stays.",)
    return Part(
        "watching",
        "Watching: recorder and audit",
        samples.figures(),
        said if can_record() else (NO_RECORDER, *said),
    )
