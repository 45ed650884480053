"""An empty hand: fingers, odometer, and what it takes to hold a strut."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_server.hands import FINGER_SPEED_M_S, OPEN_M, Hand, would_hold
from sim_server.layout import STRUT_SIDE_M, Pose

DT_S = 1e-3


def closing(hand: Hand) -> list[int]:
    """Ticks at which it would take hold, while it closes for a second."""
    hand.wanted_m = 0.0
    return [tick for tick in range(1000) if hand.move(DT_S)]


def test_fingers_move_at_their_speed_and_meet_the_strut_once() -> None:
    hand = Hand(np.zeros(3))
    (tick,) = closing(hand)
    assert tick * DT_S == pytest.approx((OPEN_M - STRUT_SIDE_M) / FINGER_SPEED_M_S, abs=2 * DT_S)
    assert hand.opening_m == 0.0


def test_fingers_that_open_or_are_closed_already_take_hold_of_nothing() -> None:
    hand = Hand(np.zeros(3), opening_m=0.0)
    assert closing(hand) == []
    hand.wanted_m = OPEN_M
    assert not any(hand.move(DT_S) for _ in range(2000))
    assert hand.opening_m == pytest.approx(OPEN_M)


def test_the_odometer_counts_from_where_it_began_in_that_frame_and_its_rates_in_the_bases() -> None:
    """By hand: it began at (1, 2), looking along y; then it drove 0.5 ahead and 0.2 to its right, and turned right."""
    hand = Hand(np.array([1.0, 2.0, math.pi / 2]))
    base = np.array([1.2, 2.5, 0.0])
    np.testing.assert_allclose(
        hand.odometry(base, np.array([0.3, 0.1, -0.4])), [0.5, -0.2, -math.pi / 2, 0.3, 0.1, -0.4], atol=1e-15
    )
    turned = hand.odometry(np.array([1.0, 2.0, math.pi / 2]), np.array([0.0, 0.7, 0.0]))
    np.testing.assert_allclose(turned, [0, 0, 0, 0.7, 0, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("place", "holds"),
    [
        ((0.0, 0.0, 0.0), True),
        ((0.05, 0.02, 0.01), True),
        ((0.07, 0.0, 0.0), False),
        ((0.0, 0.03, 0.0), False),
        ((0.0, -0.03, 0.0), False),
        ((0.0, 0.0, 0.02), False),
    ],
)
def test_a_strut_is_held_where_it_is_between_the_fingers(place: tuple[float, float, float], holds: bool) -> None:
    assert would_hold(Pose.planar(*place)) is holds


def test_a_hand_that_is_turned_too_far_does_not_hold() -> None:
    assert would_hold(Pose.planar(0, 0, 0, math.radians(10)))
    assert not would_hold(Pose.planar(0, 0, 0, math.radians(15)))
