"""What we ask of our own law, the preset `palanquin`, bound to the runs that it is checked on."""

from __future__ import annotations

from deploy.paper import claims
from deploy.paper.ablations import TIMES_THREE
from deploy.paper.claims import Found
from deploy.paper.judging import Claim
from deploy.paper.plan import SECTION_VI
from deploy.paper.results import Results


def _measured(results: Results, group: str, condition: str, law: str, seed: int, metric: str) -> float:
    """A metric; a carry that came to no number is as bad as can be."""
    value = results.metrics(results.run(group, condition, law, seed)).get(metric)
    return float(value) if isinstance(value, int | float) else float("inf")


def _bounded(name: str, says: str, where: tuple[str, str], metric: str, unit: str, bound: float) -> Claim:
    def check(results: Results, preset: str, seed: int) -> Found:
        return claims.at_most(_measured(results, *where, preset, seed, metric), unit, bound)

    return Claim(name, says, metric, where, check)


def _halved(condition: str, label: str) -> Claim:
    """Against the paper's law with the same seed: the worse of the two ratios."""

    def check(results: Results, preset: str, seed: int) -> Found:
        where = TIMES_THREE, condition
        ratios = [
            _measured(results, *where, preset, seed, metric) / _measured(results, *where, "paper", seed, metric)
            for metric in ("tilt_max_deg", "sag_max_mm")
        ]
        return claims.at_most(max(ratios), "of `paper`", 0.5)

    measures = "the worse of the ratios of tilt and sag"
    says = f"tilt and sag at most half of `paper`'s, differences x3: {label}"
    return Claim(f"x3 {condition}: half", says, measures, (TIMES_THREE, condition), check)


TARGETS: tuple[Claim, ...] = (
    *(_halved(condition.name, condition.label) for condition in SECTION_VI["VI-C"]),
    _bounded("sag", "sag in `transport`", ("VI-C", "undisturbed"), "sag_max_mm", "mm", 4.0),
    *(
        _bounded(f"overshoot {count}", f"overshoot of {count} arms", ("arms", count), "overshoot_m", "m", 0.10)
        for count in ("4", "8", "16")
    ),
    _bounded("yaw", "yaw after a lost arm", ("VI-C", "failed-grasp"), "yaw_max_deg", "deg", 6.0),
    _bounded("delay", "tilt at 20 ms of delay", ("delay", "20"), "tilt_max_deg", "deg", 1.0),
)
"""Of the preset `palanquin`."""
