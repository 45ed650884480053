"""What the paper leaves out: the same carry with one thing changed, for the paper's law and for ours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import pi

from deploy.paper.plan import PRESETS, SECTION_VI, Condition, Preset, condition_changes
from deploy.planned_run import Changes, Run, merged

DEG = 180 / pi
ALONE = "alone"
KG_PER_ARM = 5.0
"""The paper's load: 20 kg for four."""


UNDISTURBED, PUSHED, TRAJECTORY = *SECTION_VI["VI-C"][:2], SECTION_VI["VI-B"][0]


@dataclass(frozen=True, slots=True)
class Ablation:
    """One thing that is changed, with its values."""

    name: str
    label: str
    values: Mapping[str, Changes]
    presets: tuple[Preset, ...] = ("paper", "palanquin")
    of: Condition = UNDISTURBED
    """The condition that is changed. A value without changes is that condition itself, and not run again."""


def team_of(count: int) -> Changes:
    """So many arms and a load to match: mass with the number, and a rim that is long enough. The leader is no stronger,
    so the more they are the longer it takes."""
    length = max(1.6, 0.45 * count)
    return {
        "duration_s": {8: 20.0, 16: 35.0}.get(count, UNDISTURBED.duration_s),
        "team": {"count": count},
        "load": {"struts": count, "mass_kg": KG_PER_ARM * count, "size_m": [length, 0.9, 0.75]},
    }


def _gain(**gains: object) -> Changes:
    return {"team": {"gains": gains}}


X3: Changes = {"plant": {"difference_scale": 3.0}}
BY_WRIST = _gain(base_input="wrench")
SI_READING: Changes = {
    "team": {
        "gains": {
            "null_stiffness_Nm_rad": [15.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0],
            "null_damping_Nms_rad": 0.4,
            "alpha": 1.0,
            "beta": 100.0 / DEG**1.5,
        }
    }
}
"""The printed gains as if they were per radian; the law multiplies beta by (180/pi)^1.5, which is taken out here."""

SWEEPS: tuple[Ablation, ...] = (
    Ablation(
        "mass",
        "unknown mass in the hand, kg",
        {f"{mass:g}": {"load": {"mass_kg": mass}} for mass in (0.5, 1.5, 2.5, 3.0)},
        presets=("fixed", "paper", "palanquin"),
        of=TRAJECTORY,
    ),
    Ablation(
        "beta",
        "beta of eq. 15, 2.5 kg",
        {"0": _gain(beta=0.0), "25": _gain(beta=25.0), "50": _gain(beta=50.0), "100": {}, "200": _gain(beta=200.0)},
        presets=("paper",),
        of=TRAJECTORY,
    ),
)
"""The trajectory of VI-B, swept."""

ABLATIONS: tuple[Ablation, ...] = (
    Ablation(
        "reading",
        "gains read per degree, or as SI",
        {
            "per degree": {},
            "SI": SI_READING,
            "SI, fixed stiffness": merged(SI_READING, _gain(adaptive=False)),
        },
        presets=("paper",),
    ),
    Ablation(
        "alpha",
        "alpha of eq. 14",
        {"0.005": _gain(alpha=0.005), "0.02": {}, "0.1": _gain(alpha=0.1), "1": _gain(alpha=1.0)},
        presets=("paper",),
    ),
    Ablation(
        "terms",
        "terms of the paper's law left out",
        {
            "all": {},
            "no drift term (J-dot)": _gain(drift_compensation=False),
            "no observer (eq. 10)": _gain(observer=False),
            "fixed stiffness (no eq. 15)": _gain(adaptive=False),
        },
        presets=("paper",),
    ),
    Ablation(
        "differences",
        "differences between arm and model",
        {f"x{factor:g}": {"plant": {"difference_scale": factor}} for factor in (0.0, 1.0, 3.0)},
    ),
    Ablation(
        "delay",
        "delay from answer to motor, ms",
        {f"{delay}": {"plant": {"delay_ticks": delay}} for delay in (0, 2, 5, 10, 20)},
    ),
    Ablation(
        "rate",
        "control rate, Hz",
        {
            "250": {"clock": {"control_period_ms": 4}, "leader": {"period_ms": 12}},
            "500": {"clock": {"control_period_ms": 2}},
            "1000": {},
        },
    ),
    Ablation(
        "arms",
        "number of arms, 5 kg each",
        {f"{count}": team_of(count) if count != 4 else {} for count in (2, 3, 4, 8, 16)},
    ),
    Ablation(
        "off-centre",
        "centre of mass shifted forward, m",
        {f"{shift:g}": {"load": {"centre_of_mass_offset_m": [shift, 0.0, 0.0]}} for shift in (0.0, 0.15, 0.3)},
    ),
    Ablation(
        "input",
        "what drives the base",
        {
            "displacement": {},
            "wrist force": BY_WRIST,
            "displacement, noise and differences x3": X3,
            "wrist force, noise and differences x3": merged(BY_WRIST, X3),
        },
        presets=("paper",),
    ),
    Ablation(
        "input-pushed",
        "what drives the base, 50 N across",
        {"displacement": {}, "wrist force": BY_WRIST},
        presets=("paper",),
        of=PUSHED,
    ),
    Ablation(ALONE, "one arm at the 20 kg table", {"1": {"team": {"count": 1}}}),
)


TIMES_THREE = "x3"
"""Group of the carries of VI-C with three times the differences between arm and model."""


def ablation_runs(seeds: range, presets: Sequence[Preset] = tuple(PRESETS)) -> Iterator[Run]:
    """Every run of every ablation and sweep with these laws."""
    for ablation in (*ABLATIONS, *SWEEPS):
        for preset in ablation.presets:
            if preset in presets:
                for value, changes in ablation.values.items():
                    changed = merged(condition_changes(ablation.of, preset), changes)
                    for seed in seeds:
                        yield Run(ablation.name, value, preset, ablation.of.scenario, changed, seed)


def alone_runs(seeds: range, presets: Sequence[Preset] = tuple(PRESETS)) -> Iterator[Run]:
    """Those of them in which one arm fails at the table."""
    return (run for run in ablation_runs(seeds, presets) if run.group == ALONE)


def times_three_runs(seeds: range, presets: Sequence[Preset] = tuple(PRESETS)) -> Iterator[Run]:
    """The carries of VI-C with differences three times as large."""
    for condition in SECTION_VI["VI-C"]:
        for preset in condition.presets:
            if preset in presets:
                changes = merged(condition_changes(condition, preset), X3)
                for seed in seeds:
                    yield Run(TIMES_THREE, condition.name, preset, condition.scenario, changes, seed)
