"""Files that a project of this kind has, and that nothing else would hold true: citation, changelog, workflows."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

REPOSITORY = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert citation["references"][0]["title"] in " ".join((REPOSITORY / "README.md").read_text().split())


def test_the_changelog_keeps_to_its_form() -> None:
    """Keep a Changelog: first an Unreleased section, then versions with their days, known headings only."""
    lines = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()
    versions = [line for line in lines if line.startswith("## ")]
    assert versions[0] == "## [Unreleased]"
    for line in versions[1:]:
        assert re.fullmatch(r"## \[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", line), line
    headings = {line for line in lines if line.startswith("### ")}
    assert headings <= {f"### {kind}" for kind in ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security")}


def test_every_job_of_the_workflows_runs_a_target_that_is_there() -> None:
    """What a workflow asks of make exists, and each tests on the Pythons that the package says it is for."""
    targets = {line.partition(":")[0] for line in (REPOSITORY / "Makefile").read_text().splitlines() if ": " in line}
    asked = []
    for file in sorted((REPOSITORY / ".github" / "workflows").glob("*.yml")):
        workflow = yaml.safe_load(file.read_text(encoding="utf-8"))
        for job in workflow["jobs"].values():
            runs = [step["run"] for step in job["steps"] if "run" in step]
            asked += [line.split()[1] for run in runs for line in run.splitlines() if line.startswith("make ")]
    assert {"test", "docs", "wheel-check"} <= set(asked)
    assert set(asked) <= targets
    matrix = yaml.safe_load((REPOSITORY / ".github/workflows/tests.yml").read_text())["jobs"]["test"]["strategy"][
        "matrix"
    ]
    versions = [name.rpartition(" ")[2] for name in PROJECT["classifiers"] if name.startswith("Programming Language")]
    assert matrix["python"] == versions
