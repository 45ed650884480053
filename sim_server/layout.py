"""Where the struts are around a load, and where the robots stand that hold them. Geometry only.

Frames: O the load (middle of the footprint, lowest level, x forward), S a strut (origin at the grasp point, x outward
to the robot, z up), B a robot's base (on the floor, x to the load). ``X_OS`` is the pose of S in O.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_server.errors import SimError
from sim_server.scenario import Load

Array = NDArray[np.float64]

BASE_FOOTPRINT_M = (0.60, 0.50)
"""Length along the base's x, width along its y."""
BASE_GAP_M = 0.10
"""Least distance between two bases' footprints at the start."""
MIN_SPACING_M = BASE_FOOTPRINT_M[1] + BASE_GAP_M
EASY_SPACING_M = 0.70
"""Neighbours this far apart are not in each other's way; beyond it, the long sides are preferred to more distance."""

GRASP_OUTSIDE_M = 0.15
"""Grasp point outside the rim: half a hand and room to tilt."""
STRUT_VISIBLE_M = 0.25
STRUT_SIDE_M = 0.030
TOP_THICKNESS_M = 0.030
LEG_SIDE_M = 0.060
LEG_INSET_M = 0.050
"""Free rim between a leg and the edge of the table's top."""
CORNER_CLEARANCE_M = LEG_INSET_M + LEG_SIDE_M + STRUT_SIDE_M
"""Least distance of a strut's middle from a corner: clear of the leg, which stands within that distance."""
HANDLE_ABOVE_M = 0.060
"""Height of the single bearer's handle above the load: the finger tips end 10 mm below the grasp point."""

_ROUNDING_M = 1e-9


class LayoutError(SimError):
    """The struts or the robots do not fit around the load.

    Attributes:
        key: the scenario key at fault, for example ``load.struts``.
        problem, expected, fix: the parts of the message, as ``ScenarioError`` takes them.
    """

    def __init__(self, key: str, problem: str, *, expected: str, fix: str = "") -> None:
        self.key, self.problem, self.expected, self.fix = key, problem, expected, fix
        super().__init__(f"{key}: {problem}; expected {expected}" + (f". {fix}" if fix else ""))


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose ``X_AB``: position [m] of B's origin in A, and the rotation whose columns are B's axes in A."""

    p: Array
    R: Array

    def compose(self, other: Pose) -> Pose:
        """``X_AC`` from ``X_AB`` and ``X_BC``."""
        return Pose(self.p + self.R @ other.p, self.R @ other.R)

    def inverse(self) -> Pose:
        """``X_BA``."""
        return Pose(-self.R.T @ self.p, self.R.T)

    @staticmethod
    def planar(x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Pose:
        """Upright pose: position [m] and turn about z [rad]."""
        c, s = math.cos(yaw), math.sin(yaw)
        return Pose(np.array([x, y, z]), np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))

    @property
    def yaw(self) -> float:
        """Turn about z [rad], of a pose that is upright."""
        return math.atan2(self.R[1, 0], self.R[0, 0])


def cross(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    """a x b of two short vectors in plain numbers; numpy's own costs ten times as much."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@dataclass(frozen=True)
class Split:
    """Struts per side: ``side`` on either long side, ``end`` on either end, ``extra`` (0 or 1) more at the back."""

    side: int
    end: int
    extra: int


def strut_level_m(load: Load) -> float:
    """Height of the grasp points above O [m]: under a table's top, at 2/3 of a crate, at a block's middle, or on the
    handle."""
    height = load.size_m[2]
    if load.shape == "block":
        return height / 2
    if load.struts == 1:
        return height + HANDLE_ABOVE_M
    if load.shape == "crate":
        return height * 2 / 3
    return height - TOP_THICKNESS_M - STRUT_SIDE_M / 2


def strut_poses(load: Load) -> list[Pose]:
    """Poses ``X_OS`` of the load's struts; arm ``ak`` starts at strut k - 1.

    A block's one strut is its middle. Another load's only one is a handle over the middle, the robot behind it: at the
    rim, the weight of even a small crate would take the whole of a Panda's 12 N m wrist. Two are at the two ends, as on
    a stretcher. More are spread over the long sides while neighbours stay ``EASY_SPACING_M`` apart, else over all four,
    symmetric left and right. The odd one stands at the back, and those on the long sides move forward so that the mean
    of all grasp points is on the load's middle: each bearer's fair share is then 1/N.

    Order: the first is the farthest from the middle, the second opposite, and so on, so that a team smaller than the
    number of struts stands around the load, not on one side of it.

    Raises ``LayoutError`` when they do not fit.
    """
    length, width, _ = load.size_m
    level = strut_level_m(load)
    if load.struts == 1:
        return [Pose.planar(0.0, 0.0, level, math.pi)]
    long, short = max(length, width), min(length, width)
    split = _best_split(load.struts, long, short)
    if split is None:
        raise _no_room(load)
    quarter = 0.0 if length >= width else math.pi / 2  # the long axis is x, or y for a load that is wider than long
    turn = Pose.planar(0.0, 0.0, level, quarter)
    return _opposite_first([turn.compose(pose) for pose in _around(split, long, short)])


def base_poses(load: Load, X_BS: Pose) -> list[Pose]:
    """Poses ``X_OB`` of the bases that hold the struts, on the level of the strut minus ``X_BS``'s height.

    ``X_BS``: the strut in the base of a robot in its starting posture. Raises ``LayoutError`` when two footprints, or
    a footprint and the load's own, come too close.
    """
    poses = [X_OS.compose(X_BS.inverse()) for X_OS in strut_poses(load)]
    gap, i, j = min(
        ((footprint_gap(a, b), i, j) for (i, a), (j, b) in itertools.combinations(enumerate(poses), 2)),
        default=(math.inf, 0, 0),
    )
    if gap < BASE_GAP_M - _ROUNDING_M:
        raise LayoutError(
            "load.size_m",
            f"{load.struts} struts put the bases at struts {i} and {j} {gap:.2f} m apart",
            expected=f"at least {BASE_GAP_M} m between footprints of {BASE_FOOTPRINT_M} m",
            fix="A larger load or fewer struts",
        )
    for pose in poses:
        if footprint_gap(pose, Pose.planar(0.0, 0.0), other_size=load.size_m[:2]) <= 0.0:
            longest = 2 * (X_BS.p[0] - BASE_FOOTPRINT_M[0] / 2)
            raise LayoutError(
                "load.size_m",
                f"a robot would stand under the load of {load.size_m[0]} x {load.size_m[1]} m",
                expected=f"at most {math.floor(longest * 100) / 100} m along x for a load with one strut, its handle",
                fix="A shorter load or more struts",
            )
    return poses


def footprint_gap(a: Pose, b: Pose, *, other_size: tuple[float, float] = BASE_FOOTPRINT_M) -> float:
    """Least distance [m] between the footprint of a base at ``a`` and a rectangle at ``b``, along an edge's normal.

    Negative when they overlap. Between two corners the true distance is larger: the bound is on the safe side.
    """
    first, second = _corners(a, BASE_FOOTPRINT_M), _corners(b, other_size)
    axes = np.concatenate([a.R[:2, :2].T, b.R[:2, :2].T])
    gaps = [
        max((second @ n).min() - (first @ n).max(), (first @ n).min() - (second @ n).max())
        for n in axes  # separating axes: the rectangles are apart by the largest gap of their shadows
    ]
    return float(max(gaps))


def _corners(pose: Pose, size: tuple[float, float]) -> Array:
    half = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * np.asarray(size) / 2
    return np.asarray(pose.p[:2] + half @ pose.R[:2, :2].T)


def _best_split(count: int, long: float, short: float) -> Split | None:
    """Split with the largest spacing, counted up to the easy one; of equals the one with most on the long sides."""
    best: tuple[float, int] | None = None
    chosen = None
    for split in _splits(count):
        sides = [(split.side, long), (split.end, short), (split.end + split.extra, short)]
        spacing = min((room / n for n, room in sides if n > 1), default=math.inf)
        corner = min((long / 2 - abs(u) for u in _side_positions(split, long)), default=math.inf)
        corner = min([corner, *(room / n / 2 for n, room in sides[1:] if n)])
        if spacing < MIN_SPACING_M - _ROUNDING_M or corner < CORNER_CLEARANCE_M - _ROUNDING_M:
            continue
        rank = (round(min(spacing, EASY_SPACING_M), 9), split.side if count > 2 else split.end)
        if best is None or rank > best:
            best, chosen = rank, split
    return chosen


def _splits(count: int) -> Iterator[Split]:
    for side in range(count // 2 + 1):
        yield Split(side, count // 2 - side, count % 2)


def _side_positions(split: Split, long: float) -> list[float]:
    """Places of one long side's struts along it [m], moved forward to balance the odd one at the back."""
    forward = split.extra * (long / 2 + GRASP_OUTSIDE_M) / (2 * split.side) if split.side else 0.0
    return [u + forward for u in _even(split.side, long)]


def _even(count: int, room: float) -> list[float]:
    return [((k + 0.5) / count - 0.5) * room for k in range(count)]


def _around(split: Split, long: float, short: float) -> list[Pose]:
    """Strut poses counterclockwise from the front left, in a frame whose x is the long axis, on level 0."""
    u_end, v_side = long / 2 + GRASP_OUTSIDE_M, short / 2 + GRASP_OUTSIDE_M
    along = sorted(_side_positions(split, long), reverse=True)
    left = [Pose.planar(u, v_side, yaw=math.pi / 2) for u in along]
    back = [Pose.planar(-u_end, -v, yaw=math.pi) for v in _even(split.end + split.extra, short)]
    right = [Pose.planar(u, -v_side, yaw=-math.pi / 2) for u in reversed(along)]
    front = [Pose.planar(u_end, v, yaw=0.0) for v in _even(split.end, short)]
    return left + back + right + front


def _opposite_first(poses: Sequence[Pose]) -> list[Pose]:
    """The same poses: the odd ones as far as can be from those before, the even ones balancing them."""
    left = list(poses)
    chosen: list[Pose] = []
    while left:
        total = sum((pose.p[:2] for pose in chosen), np.zeros(2))
        if len(chosen) % 2:
            score = [-float(np.linalg.norm(total + pose.p[:2])) for pose in left]
        else:
            seen = [pose.p[:2] for pose in chosen] or [np.zeros(2)]
            score = [min(float(np.linalg.norm(pose.p[:2] - p)) for p in seen) for pose in left]
        chosen.append(left.pop(int(np.argmax(np.round(score, 9)))))  # rounded: a tie goes to the first in order
    return chosen


def _no_room(load: Load) -> LayoutError:
    length, width, height = load.size_m
    sizes = (tuple(math.ceil(side * k / 2 - 1e-9) / 10 for side in (length, width)) for k in itertools.count(20))
    enough = next(size for size in sizes if _best_split(load.struts, max(size), min(size)))
    return LayoutError(
        "load.struts",
        f"{load.struts} do not fit around {length} x {width} m",
        expected=f"at least {MIN_SPACING_M:.2f} m from strut to strut along a side (a base is {BASE_FOOTPRINT_M[1]} m "
        f"wide) and {CORNER_CLEARANCE_M:.2f} m from strut to corner",
        fix=f"A load of {enough[0]} x {enough[1]} x {height} m would do, or fewer struts",
    )
