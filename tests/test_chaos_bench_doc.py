"""docs/chaos-bench.md: the very text of its test, run by the plugin with real processes, and its tables."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from deploy.chaos.invariants import INVARIANTS, Bounds
from deploy.chaos.outcome import OUTCOMES

DOCS = Path(__file__).resolve().parent.parent / "docs"
PAGE = (DOCS / "chaos-bench.md").read_text(encoding="utf-8")


def block(page: str) -> str:
    """The only Python block of a page."""
    (found,) = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    return str(found)


def run_pytest(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A pytest of the user's own, which knows nothing of ours but what is installed."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=110, check=False
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder that the page describes."""
    (tmp_path / "test_my_law.py").write_text(block(PAGE), encoding="utf-8")
    (tmp_path / "spring_hand.py").write_text(block((DOCS / "own-controller.md").read_text(encoding="utf-8")))
    return tmp_path


@pytest.mark.system
@pytest.mark.timeout(240)
def test_the_test_of_the_page_passes_and_fails_for_a_law_that_lets_the_load_sag(folder: Path) -> None:
    passed = run_pytest(folder)
    assert passed.returncode == 0, passed.stdout
    assert "1 passed" in passed.stdout
    law, test = folder / "spring_hand.py", folder / "test_my_law.py"
    law.write_text(law.read_text().replace("lift_N_m: float = 6000.0", "lift_N_m: float = 100.0"))
    test.write_text(test.read_text().replace("duration_s=3.0", "duration_s=2.0"))
    failed = run_pytest(folder)
    # 24.5 N of each hand's share over 100 N/m are 0.25 m: more than the 0.08 m that it may sink
    assert failed.returncode == 1, failed.stdout
    assert "height: " in failed.stdout


@pytest.mark.system
def test_a_run_that_cannot_be_run_fails_with_what_was_said(folder: Path) -> None:
    (folder / "test_my_law.py").write_text(
        'def test_it(palanquin_run):\n    palanquin_run(events=[{"at_s": 1.0, "kind": "kill", "agent": "a9"}])\n'
    )
    failed = run_pytest(folder)
    assert failed.returncode == 1
    assert "could not be run: " in failed.stdout
    assert "no agent 'a9'" in failed.stdout


def test_what_uses_the_fixture_is_marked_and_the_plugin_loads_no_simulator(folder: Path) -> None:
    left_out = run_pytest(folder, "-m", "not palanquin", "--strict-markers")
    assert "1 deselected" in left_out.stdout, left_out.stdout
    heavy = ("mujoco", "pinocchio", "zenoh", "pydantic", "numpy")
    loaded = f"import sys, deploy.pytest_palanquin; print([name for name in {heavy} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, timeout=60, check=True)
    assert said.stdout.strip() == "[]"


def test_the_page_names_every_invariant_and_outcome_and_their_bounds() -> None:
    rows = [line.split("|")[1].strip().strip("`") for line in PAGE.splitlines() if line.startswith("| `")]
    assert rows == [invariant.__name__ for invariant in INVARIANTS] + list(OUTCOMES)
    bounds = Bounds()
    for text in (
        f"{1e3 * bounds.sink_max_m:g} mm below", f"within {bounds.tilt_max_deg:g} deg",
        f"more than {bounds.grip_max_N:g} N", f"else {bounds.goal_error_m:.2f} m", f"than {bounds.still_mm_s:g} mm/s",
    ):  # fmt: skip
        assert text in PAGE
