"""The real-time clock with real processes: a follower that is stopped is lost by the driver's rule, others carry on.

How well this machine keeps time is not judged here: only what must be true on any.
"""

from __future__ import annotations

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import launched, read_events, read_json, run_to_end

from sim_server.trace import read_trace

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(180)]

PERIOD_MS = 4
LOST_AFTER = 20
"""The scenario's default, and a real arm's: 80 ms here, where a sign of life takes 400 ms and more to go."""
VALUES = {"duration_s": 6.0, "team.count": 2, "load.mass_kg": 8.0}


@dataclass
class Seen:
    """A run in which a1 was stopped, and what it left."""

    run: dict[str, Any]
    metrics: dict[str, Any]
    events: list[dict[str, Any]]
    trace: Any
    said: str


@pytest.fixture(scope="module")
def stopped_run(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    with launched("transport-real-time", tmp_path_factory.mktemp("real-time"), VALUES) as run:
        run.wait_until_carrying(0.5)
        run.signal("a1", signal.SIGSTOP)
        run.command.wait_until(lambda: run.has("lost", agent="a1"), "the loss of a1")
        run.command.end()
        run.wait_until_nobody_is_left()
        return Seen(
            read_json(run.folder / "run.json"),
            read_json(run.folder / "metrics.json"),
            read_events(run.folder),
            read_trace(run.folder / "trace.parquet"),
            run.command.said(),
        )


def test_a_follower_that_is_stopped_is_lost_after_twenty_missed_ticks(stopped_run: Seen) -> None:
    (lost,) = [each for each in stopped_run.events if each["kind"] == "lost" and each["agent"] == "a1"]
    assert lost["why"] == f"{LOST_AFTER} ticks without an answer"  # not because its sign of life went, much later
    (warned,) = [
        each
        for each in stopped_run.events
        if each["kind"] == "missed" and each["agent"] == "a1" and lost["tick"] - LOST_AFTER < each["tick"]
    ]
    assert lost["tick"] - warned["tick"] == LOST_AFTER // 2


def test_the_others_and_the_clock_go_on_to_the_end(stopped_run: Seen) -> None:
    ticks = round(1000 * VALUES["duration_s"] / PERIOD_MS)
    assert stopped_run.run["ended"] == {"completed": True, "why": "reached its duration", "ticks": ticks}
    assert stopped_run.run["clock"] == "real-time"
    phases = {name: agent["phase"] for name, agent in stopped_run.run["agents"].items()}
    assert phases == {"a1": "lost", "a2": "ticking", "leader": "ticking"}


def test_the_arm_is_driven_by_its_last_command_until_it_is_lost(stopped_run: Seen) -> None:
    (lost,) = [each for each in stopped_run.events if each["kind"] == "lost" and each["agent"] == "a1"]
    stiffness, tick = stopped_run.trace["a1.stiffness"], stopped_run.trace["tick"]
    held = stiffness[(tick >= lost["tick"] - LOST_AFTER + 1) & (tick < lost["tick"])]
    assert len(held) >= 3
    np.testing.assert_array_equal(held, np.broadcast_to(held[0], held.shape))
    np.testing.assert_array_equal(stiffness[tick > lost["tick"]], 0)


def test_simulated_time_is_never_faster_than_the_wall_clock_and_what_it_lost_is_told(stopped_run: Seen) -> None:
    metrics = stopped_run.metrics
    # The run is over when its last tick has been stepped, which need not take a whole period.
    assert metrics["wall_s"] >= VALUES["duration_s"] - PERIOD_MS / 1000
    # The wall time that is not simulated time is what was let go, but for the last ticks' lateness and the start.
    assert metrics["wall_s"] - VALUES["duration_s"] <= metrics["slowed_s"] + 1.0
    assert (metrics["slowed_s"] > 0) == any(each["kind"] == "slowed" for each in stopped_run.events)


def test_misses_ages_and_lateness_are_in_the_metrics_and_in_what_a_person_sees(stopped_run: Seen) -> None:
    metrics, ticks = stopped_run.metrics, stopped_run.run["ended"]["ticks"]
    assert metrics["missed_ticks"]["a1"] >= LOST_AFTER
    assert metrics["missed_in_row_max"] == LOST_AFTER
    assert sum(metrics["tick_late_histogram_us"].values()) == ticks
    ages = metrics["age_ticks"]["a2"]
    assert ticks - LOST_AFTER <= sum(ages.values()) <= ticks  # every tick but those before its first answer
    assert ages["0"] > 0
    assert metrics["age_max_ticks"] >= LOST_AFTER - 1
    for word in ("ticks missed, oldest command", "missed_percent", "tick_late_us", "commands in time"):
        assert word in stopped_run.said


def test_a_follower_that_gets_sigterm_puts_its_share_down_and_goes_and_the_other_carries_on(tmp_path: Path) -> None:
    with launched("transport-real-time", tmp_path, VALUES | {"duration_s": 60.0, "team.leave_s": 0.5}) as run:
        run.wait_until_carrying(0.5)
        run.signal("a2", signal.SIGTERM)
        run.command.wait_until(lambda: run.has("left", agent="a2"), "the goodbye of a2")
        run.command.process.send_signal(signal.SIGINT)
        run.command.end()
        run.wait_until_nobody_is_left()
        kinds = [each["kind"] for each in read_events(run.folder) if each.get("agent") == "a2"]
        assert [kind for kind in kinds if kind != "missed"] == ["joined", "leaving", "hand_opened", "left"]
        assert not run.has("lost")
        assert "a2: left in order" in (run.folder / "logs" / "a2.log").read_text()


@pytest.mark.parametrize(("period", "leader"), [(3, 12), (5, 10), (20, 20)])
def test_a_control_period_that_no_arm_has_is_refused_in_real_time(period: int, leader: int, tmp_path: Path) -> None:
    changes = ("--set", f"clock.control_period_ms={period}", "--set", f"leader.period_ms={leader}")
    ended = run_to_end("run", "transport-real-time", *changes, cwd=tmp_path)
    assert ended.returncode == 2
    assert f"clock.control_period_ms: {period} in real time, where it is 1, 2 or 4" in ended.stderr
    assert list(tmp_path.iterdir()) == []
