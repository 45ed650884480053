"""The pytest plugin: ``palanquin_run`` runs a scenario with faults on the user's own follower, and judges it.

It is loaded with every pytest of an environment that has Palanquin, so nothing of the simulator is imported before a
test asks for the fixture.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from deploy.chaos.invariants import Finding
    from deploy.chaos.outcome import Judgement, Outcome
    from sim_server.verdict import Verdict

MARKER = "palanquin"
SHORT_S = 6.0
"""Simulated time of a run that says nothing else: a test's time, not a carry's."""

Runner = Callable[..., "PalanquinRun"]


@dataclass(frozen=True)
class PalanquinRun:
    """A run that has ended."""

    folder: Path
    """trace.parquet, events.jsonl, metrics.json, run.json, audit.json, logs/."""
    metrics: Mapping[str, Any]
    """docs/metrics.md; its ``verdict`` is by the scenario's ``[expect]``."""
    judgement: Judgement

    @property
    def invariants(self) -> Mapping[str, Finding]:
        """What each invariant says, by its name."""
        return {finding.invariant: finding for finding in self.judgement.findings}

    @property
    def violated(self) -> list[str]:
        """A line for each invariant that is: its name, when, and by how much."""
        return [f"{finding.invariant}: {finding.text}" for finding in self.judgement.violated]

    @property
    def outcome(self) -> Outcome:
        """What became of the load: carries, stops, moves, drops, unknown."""
        return self.judgement.outcome

    @property
    def verdict(self) -> Verdict:
        """By all invariants: holds, violated, unknown."""
        return self.judgement.verdict


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line(
        "markers",
        f"{MARKER}(**changes): starts a simulator and a team of followers; its keyword arguments are the test's "
        "defaults for palanquin_run. Every test with that fixture has it.",
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what uses the fixture, so that ``-m "not palanquin"`` leaves it out."""
    for item in items:
        if "palanquin_run" in getattr(item, "fixturenames", ()) and not item.get_closest_marker(MARKER):
            item.add_marker(MARKER)


@pytest.fixture
def palanquin_run(request: pytest.FixtureRequest, tmp_path: Path) -> Runner:
    """``palanquin_run(scenario="transport", *, controller=None, events=None, seed=1, **changes)``: run it, judge it.

    Args:
        scenario: a shipped scenario's name, or a file beside the test.
        controller: the law under test, ``module:Class``; its module is looked for beside the test, then on PYTHONPATH.
        events: faults, each a table as in a scenario's ``[[events]]``.
        changes: anything else of a scenario file, such as ``duration_s=8.0`` or ``team={"when_lost": "brake"}``.

    The test fails, with what was said, if the run could not be run.
    """
    marker = request.node.get_closest_marker(MARKER)
    defaults: Mapping[str, Any] = dict(marker.kwargs) if marker else {}
    beside = request.path.parent
    number = 0

    def run(
        scenario: str | None = None,
        *,
        controller: str | None = None,
        events: Sequence[Mapping[str, Any]] | None = None,
        seed: int | None = None,
        **changes: Any,
    ) -> PalanquinRun:
        nonlocal number
        number += 1
        given = {"scenario": scenario, "controller": controller, "events": events, "seed": seed, **changes}
        given = {key: value for key, value in given.items() if value is not None}
        return _run(defaults, given, beside, tmp_path / f"run-{number}")

    return run


def _run(defaults: Mapping[str, Any], given: Mapping[str, Any], beside: Path, folder: Path) -> PalanquinRun:
    """Run what is given, with the test's defaults below it."""
    from deploy.batch import run_one
    from deploy.chaos.outcome import judge_folder
    from deploy.planned_run import Run, merged
    from sim_server.run_folder import METRICS

    changes = merged({"duration_s": SHORT_S}, merged(defaults, given))
    scenario, seed = str(changes.pop("scenario", "transport")), int(changes.pop("seed", 1))
    if (beside / scenario).is_file():
        scenario = str(beside / scenario)
    controller = changes.pop("controller", None)
    if controller is not None:
        changes = merged(changes, {"team": {"controller": controller}})
    problem = run_one(Run("pytest", "", "", scenario, changes, seed, may_lose=True), str(folder), cwd=str(beside))
    if problem:
        pytest.fail(f"{shlex.quote(scenario)} could not be run: {problem}", pytrace=False)
    metrics = json.loads((folder / METRICS).read_text(encoding="utf-8"))
    return PalanquinRun(folder, metrics, judge_folder(folder))
