"""The page on the law names every equation that is written, and no other."""

from __future__ import annotations

import re
from pathlib import Path

from agents.equations import bounds as bounds_equations
from agents.equations import impedance as impedance_equations
from agents.equations import law as law_equations
from agents.equations import null_space as null_equations
from agents.equations import observer as observer_equations
from agents.equations import reference as reference_equations
from agents.equations import saturation as saturation_equations
from agents.equations import stiffness as stiffness_equations
from agents.equations import task as task_equations
from agents.equations import wrist as wrist_equations
from agents.equations import yaw as yaw_equations

PAGE = Path(__file__).resolve().parent.parent / "docs" / "control-law.md"


def test_the_page_on_the_law_names_every_equation_and_no_other() -> None:
    named = set(
        re.findall(
            r"`(\w+)`", re.sub(r"^(?!\| ).*$", "", PAGE.read_text(encoding="utf-8").split("## Gains")[0], flags=re.M)
        )
    )
    written = {
        name
        for module in (
            bounds_equations,
            impedance_equations,
            law_equations,
            null_equations,
            observer_equations,
            reference_equations,
            saturation_equations,
            stiffness_equations,
            task_equations,
            wrist_equations,
            yaw_equations,
        )
        for name, function in vars(module).items()
        if getattr(function, "__module__", None) == module.__name__ and not name.startswith("_")
    }
    assert named == written
