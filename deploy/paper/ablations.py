"""What the paper leaves out: the same carry with one thing changed, for the paper's law and for ours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import pi

from deploy.paper.plan import PRESETS, RECORD, Changes, Preset, Run, merged

DEG = 180 / pi
CARRY_S = 12.0
"""Length of an ablation's carry: the paper's law arrives after 8 s."""
KG_PER_ARM = 5.0
"""The paper's load: 20 kg for four."""


@dataclass(frozen=True, slots=True)
class Ablation:
    """One thing that is changed, with its values."""

    name: str
    label: str
    values: Mapping[str, Changes]
    presets: tuple[Preset, ...] = ("paper", "palanquin")
    scenario: str = "transport"


def team_of(count: int) -> Changes:
    """So many arms and a load to match: mass with the number, and a rim that is long enough."""
    length = max(1.6, 0.45 * count)
    return {
        "team": {"count": count},
        "load": {"struts": count, "mass_kg": KG_PER_ARM * count, "size_m": [length, 0.9, 0.75]},
    }


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
        presets=("fixed", "paper"),
        scenario="trajectory",
    ),
    Ablation(
        "beta",
        "beta of eq. 15, 2.5 kg",
        {f"{beta:g}": {"team": {"gains": {"beta": beta}}} for beta in (0.0, 25.0, 50.0, 100.0, 200.0)},
        presets=("paper",),
        scenario="trajectory",
    ),
)
"""The trajectory of VI-B, swept."""
SWEEP_S = 12.0

ABLATIONS: tuple[Ablation, ...] = (
    Ablation(
        "reading",
        "gains read per degree, or as SI",
        {
            "per degree": {},
            "SI": SI_READING,
            "SI, fixed stiffness": merged(SI_READING, {"team": {"gains": {"adaptive": False}}}),
        },
        presets=("paper",),
    ),
    Ablation(
        "alpha",
        "alpha of eq. 14",
        {f"{alpha:g}": {"team": {"gains": {"alpha": alpha}}} for alpha in (0.005, 0.02, 0.1, 1.0)},
        presets=("paper",),
    ),
    Ablation(
        "terms",
        "terms of the paper's law left out",
        {
            "all": {},
            "no drift term (J-dot)": {"team": {"gains": {"drift_compensation": False}}},
            "no observer (eq. 10)": {"team": {"gains": {"observer": False}}},
            "fixed stiffness (no eq. 15)": {"team": {"gains": {"adaptive": False}}},
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
            f"{1000 // period}": {"clock": {"control_period_ms": period}, "leader": {"period_ms": 12}}
            for period in (4, 2, 1)
        },
    ),
    Ablation("arms", "number of arms, 5 kg each", {f"{count}": team_of(count) for count in (2, 3, 4, 8, 16)}),
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
            "wrist force": {"team": {"gains": {"base_input": "wrench"}}},
        },
        presets=("paper",),
    ),
    Ablation("alone", "one arm at the 20 kg table", {"1": {"team": {"count": 1}}}),
)


def ablation_runs(seeds: range) -> Iterator[Run]:
    """Every run of every ablation and sweep."""
    for ablation in (*ABLATIONS, *SWEEPS):
        for preset in ablation.presets:
            for value, changes in ablation.values.items():
                length: Changes = {"duration_s": CARRY_S if ablation in ABLATIONS else SWEEP_S}
                changed = merged(merged(merged(length, RECORD), PRESETS[preset]), changes)
                for seed in seeds:
                    yield Run(ablation.name, value, preset, ablation.scenario, changed, seed)
