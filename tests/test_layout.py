"""Struts and robots around a load: evenly, clear of corners, nobody in anybody's way."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from sim_server.errors import SimError
from sim_server.layout import (
    BASE_FOOTPRINT_M,
    BASE_GAP_M,
    CORNER_CLEARANCE_M,
    GRASP_OUTSIDE_M,
    MIN_SPACING_M,
    LayoutError,
    Pose,
    base_poses,
    footprint_gap,
    strut_poses,
)
from sim_server.scenario import Load

X_BS = Pose(np.array([0.52, 0.0, 0.8]), np.diag([-1.0, -1.0, 1.0]))
"""The strut half a metre before the base, facing it."""


def load(struts: int, length: float, width: float, **other: Any) -> Load:
    return Load(struts=struts, size_m=(length, width, 0.75), **other)


ROUND_RIM = [
    load(2, 1.6, 0.9),
    load(3, 1.6, 0.9),
    load(4, 1.6, 0.9),
    load(4, 0.6, 0.6, shape="crate"),
    load(4, 0.9, 1.6),
    load(5, 1.6, 0.9),
    load(5, 0.9, 1.6),
    load(6, 2.4, 1.0),
    load(7, 2.4, 1.0),
    load(8, 3.0, 1.2),
    load(8, 2.4, 1.4),
    load(9, 3.0, 1.4),
    load(11, 3.4, 2.0),
    load(12, 3.0, 2.4),
    load(15, 4.6, 2.0),
    load(16, 4.0, 2.0),
]


def load_name(a_load: Load) -> str:
    return f"{a_load.struts}@{a_load.size_m[0]}x{a_load.size_m[1]}"


every_load = pytest.mark.parametrize("a_load", ROUND_RIM, ids=load_name)


def rim_distance(a_load: Load, pose: Pose) -> tuple[float, float]:
    """Distance of the grasp point outside the rim along the strut, and of the strut from the side's nearest corner."""
    half = np.array(a_load.size_m[:2]) / 2
    out = pose.R[:2, 0]
    along = np.array([-out[1], out[0]])
    reach, room = np.abs(out) @ half, np.abs(along) @ half
    return float(out @ pose.p[:2] - reach), float(room - abs(along @ pose.p[:2]))


@every_load
def test_each_strut_stands_straight_out_of_its_side_and_clear_of_the_corners(a_load: Load) -> None:
    poses = strut_poses(a_load)
    assert len(poses) == a_load.struts
    for pose in poses:
        outside, corner = rim_distance(a_load, pose)
        assert np.abs(pose.R[:2, 0]).max() == pytest.approx(1.0, abs=1e-12)  # along x or y; rounding of cos
        assert outside == pytest.approx(GRASP_OUTSIDE_M, abs=1e-12)
        assert corner >= CORNER_CLEARANCE_M - 1e-9
        np.testing.assert_allclose(np.cross(pose.R[:, 2], pose.R[:, 0]), pose.R[:, 1], atol=1e-15)
        np.testing.assert_array_equal(pose.R[:, 2], [0, 0, 1])


@every_load
def test_equal_shares_carry_the_load_level(a_load: Load) -> None:
    """The mean of the grasp points is the load's middle, so equal vertical forces make no moment about it."""
    mean = np.mean([pose.p for pose in strut_poses(a_load)], axis=0)
    np.testing.assert_allclose(mean[:2], 0, atol=1e-12)


@every_load
def test_neighbours_on_a_side_are_a_base_width_and_a_gap_apart(a_load: Load) -> None:
    for a, b in itertools.combinations(strut_poses(a_load), 2):
        if np.allclose(a.R, b.R):
            assert np.linalg.norm(a.p - b.p) >= MIN_SPACING_M - 1e-9


@every_load
def test_bases_face_the_load_and_keep_their_distance(a_load: Load) -> None:
    """Against points on the rectangles' edges, every 2 cm: a check that knows nothing of separating axes."""
    struts, bases = strut_poses(a_load), base_poses(a_load, X_BS)
    outlines = [outline(pose) for pose in bases]
    for strut, base in zip(struts, bases, strict=True):
        np.testing.assert_allclose(base.R[:, 0], -strut.R[:, 0], atol=1e-12)
    for a, b in itertools.combinations(outlines, 2):
        distance = np.linalg.norm(a[:, None] - b[None], axis=2).min()
        assert distance >= BASE_GAP_M - 1e-9  # no overlap hides: one outline inside the other cannot be, of one size


def outline(pose: Pose) -> Any:
    length, width = BASE_FOOTPRINT_M
    u, v = np.linspace(-0.5, 0.5, 31) * length, np.linspace(-0.5, 0.5, 26) * width
    points = [(x, s * width / 2) for x in u for s in (1, -1)] + [(s * length / 2, y) for y in v for s in (1, -1)]
    return pose.p[:2] + np.array(points) @ pose.R[:2, :2].T


@pytest.mark.parametrize("a_load", [a_load for a_load in ROUND_RIM if a_load.struts % 2 == 0], ids=load_name)
def test_a_smaller_team_of_even_size_stands_balanced_around_the_load(a_load: Load) -> None:
    points = np.array([pose.p[:2] for pose in strut_poses(a_load)])
    for count in range(2, a_load.struts + 1, 2):
        np.testing.assert_allclose(points[:count].mean(axis=0), 0, atol=1e-12)


def test_four_on_the_standard_table_stand_two_on_each_long_side() -> None:
    found = {(round(float(p.p[0]), 9), round(float(p.p[1]), 9)) for p in strut_poses(Load())}
    assert found == {(0.4, 0.6), (0.4, -0.6), (-0.4, 0.6), (-0.4, -0.6)}
    assert strut_poses(Load())[0].p[2] == pytest.approx(0.75 - 0.03 - 0.015)  # bar of 30 mm under a top of 30 mm


def test_two_bearers_stand_at_the_ends_as_on_a_stretcher() -> None:
    np.testing.assert_allclose(
        [pose.p[:2] for pose in strut_poses(load(2, 1.6, 0.9))], [[-0.95, 0], [0.95, 0]], atol=1e-12
    )


def test_the_odd_one_stands_at_the_back() -> None:
    poses = strut_poses(load(3, 1.6, 0.9))
    assert min(pose.p[0] for pose in poses) == pytest.approx(-0.95)
    assert sorted(round(float(pose.p[0]), 9) for pose in poses)[1:] == [0.475, 0.475]


def test_a_crate_is_grasped_at_two_thirds_of_its_height() -> None:
    crate = Load(shape="crate", size_m=(0.6, 0.6, 0.3), struts=4)
    assert all(pose.p[2] == pytest.approx(0.2) for pose in strut_poses(crate))


def test_a_single_bearer_holds_a_handle_over_the_middle_from_behind() -> None:
    crate = Load(shape="crate", size_m=(0.4, 0.4, 0.3), struts=1)
    (strut,), (base,) = strut_poses(crate), base_poses(crate, X_BS)
    np.testing.assert_allclose(strut.p, [0, 0, 0.36], atol=1e-12)
    np.testing.assert_allclose(base.p[:2], [-0.52, 0], atol=1e-12)


def test_a_single_bearer_does_not_stand_under_its_load() -> None:
    with pytest.raises(LayoutError, match=r"load\.size_m.*at most 0\.44 m"):
        base_poses(Load(struts=1, size_m=(1.6, 0.9, 0.75)), X_BS)


def test_bases_that_would_meet_around_a_corner_are_refused() -> None:
    crate = load(4, 0.6, 0.6, shape="crate")
    near = Pose(
        np.array([0.15, 0.0, 0.8]), X_BS.R
    )  # a reach so short that the fronts are 5 cm from the next one's side
    with pytest.raises(LayoutError, match=r"load\.size_m: 4 struts put .* 0\.05 m apart; expected at least 0\.1 m"):
        base_poses(crate, near)


@pytest.mark.parametrize(("struts", "length", "width"), [(16, 1.6, 0.9), (6, 0.8, 0.8), (3, 0.3, 0.3), (9, 0.5, 2.0)])
def test_too_many_struts_are_refused_and_the_size_that_is_named_would_do(
    struts: int, length: float, width: float
) -> None:
    with pytest.raises(LayoutError) as caught:
        strut_poses(load(struts, length, width))
    error = caught.value
    assert isinstance(error, SimError)
    assert error.key == "load.struts"
    assert f"{struts} do not fit around {length} x {width} m" in str(error)
    assert f"at least {MIN_SPACING_M:.2f} m" in error.expected
    named = [float(word) for word in error.fix.removeprefix("A load of ").split(" m ")[0].split(" x ")]
    assert len(base_poses(load(struts, named[0], named[1]), X_BS)) == struts


def test_footprints_apart_touching_and_overlapping() -> None:
    here = Pose.planar(0, 0)
    assert footprint_gap(here, Pose.planar(0.9, 0)) == pytest.approx(0.3)
    assert footprint_gap(here, Pose.planar(0, 0.6)) == pytest.approx(0.1)
    assert footprint_gap(here, Pose.planar(0.1, 0.1, yaw=0.7)) < 0
    # A square corner first: the half diagonal of 0.6 x 0.5 is 0.3905 long, at atan2(0.5, 0.6) from the x axis.
    turned = Pose.planar(1.0, 0, yaw=-np.arctan2(0.5, 0.6))
    assert footprint_gap(here, turned) == pytest.approx(1.0 - 0.3 - np.hypot(0.6, 0.5) / 2)


def test_pose_algebra_undoes_itself() -> None:
    a, b = Pose.planar(1, 2, 3, 0.4), Pose(np.array([0.1, -0.2, 0.3]), np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]))
    back = a.compose(b).compose(b.inverse()).compose(a.inverse())
    np.testing.assert_allclose(back.p, 0, atol=1e-14)
    np.testing.assert_allclose(back.R, np.eye(3), atol=1e-14)
    point = np.array([0.7, 0.8, 0.9])  # composing is applying one after the other
    ab = a.compose(b)
    np.testing.assert_allclose(ab.p + ab.R @ point, a.p + a.R @ (b.p + b.R @ point), atol=1e-14)
    assert a.yaw == pytest.approx(0.4)
