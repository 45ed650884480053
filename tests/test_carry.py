"""The claim itself: the paper's law carries the table to the goal, and adaptive stiffness does it better.

Whole carries run in one process here (benchmarks/one_process.py), without a wire: a quarter of the time. That
the real processes do the same is another claim, and tested as such: number for number, over the first part of a carry.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from one_process import CarriedOnce, carried
from processes import run_to_end

from sim_server.scenario_files import load_scenario
from sim_server.trace import read_trace


def carry(name: str, **changes: Any) -> CarriedOnce:
    """A scenario carried in this process."""
    return carried(load_scenario(name, changes).scenario)


@pytest.fixture(scope="module")
def transport() -> CarriedOnce:
    return carry("transport")


@pytest.mark.timeout(400)
def test_four_arms_carry_the_table_to_the_goal(transport: CarriedOnce) -> None:
    metrics = transport.metrics()
    assert metrics["duration_s"] == pytest.approx(20.0, abs=0.01)
    # The issue's own bounds, not what was measured: they must hold whatever else changes.
    assert metrics["goal_error_m"] <= 0.10
    assert metrics["end_speed_mm_s"] <= 5.0  # standing still: it would take minutes to leave the goal's 0.10 m
    assert metrics["tilt_max_deg"] <= 0.5
    assert metrics["sag_max_mm"] <= 12.0
    assert metrics["leader_force_max_N"] <= 40.0


@pytest.mark.system
@pytest.mark.timeout(200)
def test_four_silent_processes_do_the_same_number_for_number(transport: CarriedOnce, tmp_path: Path) -> None:
    """Borders between processes, messages, credentials and walls change no bit of the carry."""
    out = tmp_path / "run"
    done = run_to_end("run", "transport", "--set", "duration_s=1.5", "--out", out, cwd=tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr  # the goal is not reached by then
    real = read_trace(out / "trace.parquet")
    rows = len(real["tick"])
    assert rows == 300
    for name, values in real.items():
        if not name.endswith("age_ticks"):
            np.testing.assert_array_equal(values, transport.trace[name][:rows], err_msg=name)


@pytest.mark.timeout(300)
def test_adaptive_stiffness_sags_and_tilts_clearly_less_than_fixed(transport: CarriedOnce) -> None:
    span_s = 6.0  # the pull, the fastest part of the carry, and the start of braking
    adaptive = transport.metrics(span_s)
    fixed = carry("transport-fixed-stiffness", duration_s=span_s).metrics()
    # Seen: sag 7.9 and 13.8 mm, rms tilt 0.09 and 0.17 deg. "Clearly" is taken as a fifth less.
    assert adaptive["sag_max_mm"] < 0.8 * fixed["sag_max_mm"]
    assert adaptive["tilt_rms_deg"] < 0.8 * fixed["tilt_rms_deg"]


@pytest.mark.timeout(300)
def test_a_table_that_nobody_leads_is_held_and_hardly_drifts() -> None:
    metrics = carry("hold", duration_s=5.0).metrics()
    assert metrics["sag_max_mm"] <= 12.0
    assert metrics["tilt_max_deg"] <= 0.5
    # Trap: with alpha = 1 in the law a sagging table runs away by metres. Seen: 3 mm/min; a hundred would be a runaway.
    assert metrics["drift_mm_per_min"] < 30.0
