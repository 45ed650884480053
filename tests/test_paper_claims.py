"""The claim checks, on traces made by hand: one that keeps each claim, and one that breaks it and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from deploy.paper import claims
from deploy.paper.judging import verdict_of
from deploy.paper.statistics import spread

Array = NDArray[np.float64]

TIME_S = np.arange(0.0, 10.0, 0.01)
GOAL = (2.0, 0.0)


def quats(tilt_deg: Array, yaw_deg: Array | float = 0.0) -> Array:
    """Rolled by one angle, then turned by the other, (rows, 4) w first."""
    roll, yaw = np.radians(tilt_deg) / 2, np.radians(np.broadcast_to(yaw_deg, np.shape(tilt_deg))) / 2
    return np.stack(
        [
            np.cos(yaw) * np.cos(roll),
            np.cos(yaw) * np.sin(roll),
            np.sin(yaw) * np.sin(roll),
            np.sin(yaw) * np.cos(roll),
        ],
        axis=1,
    )


def carried(**changed: Any) -> dict[str, Array]:
    """A load that goes straight to the goal in five seconds, level and at one height."""
    x = np.minimum(TIME_S / 5.0, 1.0) * GOAL[0]
    place = np.stack([x, np.zeros_like(x), np.full_like(x, 0.1)], axis=1)
    return {"time_s": TIME_S, "load.position": place, "load.quat_wxyz": quats(np.zeros_like(x))} | changed


def bump(height: float, begin_s: float, end_s: float) -> Array:
    return np.where((begin_s <= TIME_S) & (end_s > TIME_S), height, 0.0)


def test_a_hand_that_yields_in_the_plane_alone_is_selective_and_one_that_yields_alike_is_not() -> None:
    swing = 0.05 * np.sin(TIME_S)
    still = np.zeros_like(swing)
    assert claims.selectivity(np.stack([swing, still, 0.01 * swing], axis=1)).holds
    assert not claims.selectivity(np.stack([swing, swing, swing], axis=1)).holds


@pytest.mark.parametrize(("moved_m", "holds"), [(0.019, True), (-0.019, True), (0.021, False), (-0.021, False)])
def test_height_is_kept_up_to_its_bound_both_ways(moved_m: float, holds: bool) -> None:
    hand = np.stack([TIME_S, TIME_S, bump(moved_m, 2.5, 5)], axis=1)  # a quarter of the time: half in the mean square
    found = claims.height_kept(hand)
    assert found.holds is holds
    assert found.value == pytest.approx(1e3 * abs(moved_m) / 2)


@pytest.mark.parametrize(("tilted_deg", "holds"), [(1.9, True), (2.1, False)])
def test_level_is_kept_up_to_its_bound(tilted_deg: float, holds: bool) -> None:
    found = claims.level_kept(carried(**{"load.quat_wxyz": quats(bump(tilted_deg, 2.5, 5))}))
    assert found.holds is holds
    assert found.value == pytest.approx(tilted_deg / 2)


def test_smaller_errors_and_torques_are_ratios_of_dynamic_to_fixed() -> None:
    error = np.sin(TIME_S)
    assert claims.smaller_error(error, 0.6 * error).value == pytest.approx(0.6)
    assert claims.smaller_error(error, 0.6 * error).holds
    assert not claims.smaller_error(0.6 * error, error).holds
    torque = np.tile([1.0, -2.0, 3.0], (len(TIME_S), 1))
    light, heavy = carried(**{"a1.tau": 0.9 * torque}), carried(**{"a1.tau": torque})
    assert claims.summed_torque(heavy)[0] == 6.0, "signs do not cancel"
    assert claims.smaller_torque(heavy, light).value == pytest.approx(0.9)
    assert not claims.smaller_torque(light, heavy).holds


def torques(settles_s: float) -> dict[str, Array]:
    """A periodic torque (1 s) on top of one that falls to its final value at that time."""
    level = 10.0 + 5.0 * np.maximum(0.0, 1.0 - TIME_S / settles_s) + np.sin(2 * np.pi * TIME_S)
    return carried(**{"a1.tau": level[:, None]})


def test_torque_has_settled_when_its_mean_over_a_period_stays_close_to_the_last() -> None:
    # Falling by 5 N m over 4 s: within 1 % of 10 N m at the end of the fall, less a little, plus up to a period.
    assert 2.5 < claims.settling_time_s(torques(4.0), 1.0) < 4.0
    assert claims.settling_time_s(torques(0.01), 1.0) == 0.0
    assert claims.faster_convergence(torques(6.0), torques(2.0), 1.0).holds
    assert not claims.faster_convergence(torques(2.0), torques(6.0), 1.0).holds
    short = {name: values[:150] for name, values in torques(0.5).items()}
    assert claims.settling_time_s(short, 1.0) == float("inf"), "a trace of less than two periods says nothing"


@pytest.mark.parametrize(("short_m", "holds"), [(0.29, True), (0.31, False)])
def test_a_load_has_arrived_within_its_distance_of_the_goal(short_m: float, holds: bool) -> None:
    trace = carried()
    trace["load.position"] = trace["load.position"] * [1 - short_m / 2.0, 1, 1]
    assert claims.arrives(trace, GOAL).holds is holds


@pytest.mark.parametrize("condition", claims.TILT_DEG)
def test_every_condition_has_its_own_bound_of_tilt(condition: str) -> None:
    bound = claims.TILT_DEG[condition]
    assert claims.stays_level(carried(**{"load.quat_wxyz": quats(bump(bound - 0.01, 2, 3))}), condition).holds
    assert not claims.stays_level(carried(**{"load.quat_wxyz": quats(bump(bound + 0.01, 2, 3))}), condition).holds


def test_a_detour_is_no_straight_way_and_coming_back_from_beyond_the_goal_is_no_detour() -> None:
    assert claims.goes_straight(carried(), GOAL).value == pytest.approx(1.0)
    detour = carried()
    detour["load.position"] = detour["load.position"] + np.stack([0 * TIME_S, bump(0.2, 1, 4), 0 * TIME_S], axis=1)
    assert not claims.goes_straight(detour, GOAL).holds
    beyond = carried()
    beyond["load.position"][:, 0] += np.where(TIME_S > 6, 0.05 * np.sin(TIME_S - 6), 0.0)
    assert claims.goes_straight(beyond, GOAL).holds


def test_a_tilt_that_stays_after_a_push_is_not_come_back_from() -> None:
    assert claims.comes_back(carried(**{"load.quat_wxyz": quats(bump(5.0, 2, 4.9))}), 2.0, 4.0).holds
    assert not claims.comes_back(carried(**{"load.quat_wxyz": quats(bump(0.3, 2, 9))}), 2.0, 4.0).holds
    tilted_before = quats(np.full_like(TIME_S, 3.0))
    assert claims.comes_back(carried(**{"load.quat_wxyz": tilted_before}), 2.0, 4.0).holds


def test_a_loss_is_felt_only_if_both_tilt_and_yaw_are_twice_the_undisturbed() -> None:
    undisturbed = carried(**{"load.quat_wxyz": quats(bump(0.2, 1, 2), bump(0.3, 1, 2))})
    both = carried(**{"load.quat_wxyz": quats(bump(0.6, 1, 2), bump(0.9, 1, 2))})
    tilt_only = carried(**{"load.quat_wxyz": quats(bump(0.6, 1, 2), bump(0.3, 1, 2))})
    yaw_only = carried(**{"load.quat_wxyz": quats(bump(0.2, 1, 2), bump(0.9, 1, 2))})
    assert claims.is_felt(both, undisturbed).holds
    assert not claims.is_felt(tilt_only, undisturbed).holds
    assert not claims.is_felt(yaw_only, undisturbed).holds


def test_what_a_push_tilts_is_measured_from_when_it_begins_to_a_second_after_its_end() -> None:
    def found(tilt: Array) -> claims.Found:
        return claims.tilts_little(carried(**{"load.quat_wxyz": quats(tilt)}), 3.0, 5.0, "pushed")

    assert found(bump(5.0, 0.0, 2.9)).value == pytest.approx(0.0, abs=1e-6), "what was before is not the push's"
    assert found(bump(5.0, 6.5, 10.0)).value == pytest.approx(0.0, abs=1e-6)
    for begin_s, end_s in ((3.0, 4.0), (4.9, 5.5), (5.5, 6.5)):
        assert found(bump(0.9, begin_s, end_s)).holds
        assert not found(bump(1.1, begin_s, end_s)).holds
    assert found(0.3 - bump(0.3, 3.5, 4.0)).value == pytest.approx(0.3, abs=1e-6), "less tilt is a change too"


def test_one_arm_fails_if_a_corner_of_the_load_comes_down_to_the_floor() -> None:
    footprint = (1.6, 0.9)
    assert claims.needs_a_team(carried(), footprint).value == pytest.approx(0.1)
    assert not claims.needs_a_team(carried(), footprint).holds
    down = carried()
    down["load.position"][:, 2] -= bump(0.11, 3, 10)
    assert claims.needs_a_team(down, footprint).holds
    for tilt, holds in ((12.0, False), (14.0, True)):  # 0.45 m sin(12.8 deg) = 0.1 m, whatever the yaw
        rolled = claims.needs_a_team(carried(**{"load.quat_wxyz": quats(bump(tilt, 3, 10), 30.0)}), footprint)
        assert rolled.value == pytest.approx(0.1 - 0.45 * np.sin(np.radians(tilt)))
        assert rolled.holds is holds


@pytest.mark.parametrize(
    ("holds", "verdict"),
    [
        ([], "unknown"),
        ([True], "holds"),
        ([True] * 19 + [False], "holds"),
        ([True] * 9 + [False], "unknown"),
        ([True, False], "violated"),
        ([False] * 20, "violated"),
    ],
)
def test_a_verdict_is_one_of_nearly_all_seeds_or_none(holds: list[bool], verdict: str) -> None:
    assert verdict_of(holds) == verdict


def test_a_spread_leaves_out_what_is_missing_and_says_how_many_are_in() -> None:
    found = spread([1.0, None, 3.0, 2.0])
    assert found is not None
    assert (found.median, found.worst, found.count) == (2.0, 3.0, 3)
    assert spread([None, None]) is None
