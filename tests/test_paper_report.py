"""docs/paper.md, paper.json and the README say the same, and the figures are there."""

from __future__ import annotations

import json
import re
from pathlib import Path

from deploy.paper.report import claims_summary
from deploy.paper.verifying import REPORT, read_report

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"


def test_the_readmes_claims_are_those_of_the_report() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert claims_summary(json.loads((DOCS / REPORT).read_text(encoding="utf-8"))) in readme


def test_every_picture_of_the_report_is_there() -> None:
    pictures = re.findall(r"\]\((\S+\.png)\)", (DOCS / "paper.md").read_text(encoding="utf-8"))
    assert len(pictures) >= 7
    assert [name for name in pictures if not (DOCS / name).exists()] == []


def test_every_condition_has_twenty_seeds() -> None:
    counted: dict[tuple[str, str, str], set[int]] = {}
    for entry in read_report(DOCS)["runs"]:
        counted.setdefault((entry["group"], entry["condition"], entry["law"]), set()).add(entry["seed"])
    experiments = {key: found for key, found in counted.items() if key[0].startswith("VI-")}
    assert len(experiments) == 4 + 3 + 10
    assert {len(found) for found in experiments.values()} == {20}
