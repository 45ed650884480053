"""Snapshots: values are the same after bytes, and whoever is restored goes on as the one that it was taken from."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from sim_server.motor_drivers import MotorDrivers
from sim_server.sensor_noise import TICKS_AHEAD, SensorNoise
from sim_server.snapshot import SnapshotError, fill, pack, random_state, set_random_state, unpack
from sim_server.unled_arms import Behaviour, Brake, Felt, LetDown, Limp, Release

Array = NDArray[np.float64]

leaves = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text()
    | st.binary()
    | arrays(np.float64, array_shapes(min_side=0, max_dims=2, max_side=3))
)
names = st.text(max_size=4)
trees = st.dictionaries(
    names,
    st.recursive(leaves, lambda of: st.lists(of, max_size=3) | st.dictionaries(names, of, max_size=3), max_leaves=6),
    max_size=4,
)


def same(one: Any, other: Any) -> bool:
    """Equal bit by bit, so that a NaN equals itself and 0.0 is not -0.0."""
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.ndarray | float):
        left, right = np.asarray(one), np.asarray(other)
        return left.shape == right.shape and left.tobytes() == right.tobytes()
    return type(one) is type(other) and bool(one == other)


@settings(max_examples=60)
@given(trees)
def test_a_snapshot_is_the_same_after_bytes(tree: dict[str, Any]) -> None:
    assert same(tree, unpack(pack(tree)))


@settings(max_examples=100)
@given(st.binary() | trees.map(pack).flatmap(lambda data: st.integers(0, len(data)).map(lambda cut: data[:cut])))
def test_any_bytes_are_a_snapshot_or_refused(data: bytes) -> None:
    try:
        found = unpack(data)
    except SnapshotError:
        return
    assert isinstance(found, dict)


def test_what_is_no_plain_value_is_not_packed() -> None:
    for value in (object(), np.zeros(2, dtype=complex), {1, 2}):
        with pytest.raises(TypeError, match="cannot hold"):
            pack({"it": value})


def test_an_array_of_another_shape_is_never_spread_over_the_target() -> None:
    target = np.zeros((2, 3))
    for saved in (np.ones(3), np.ones((1, 3)), np.ones(()), [[1.0] * 3] * 2):
        with pytest.raises(SnapshotError):
            fill(target, saved)
    np.testing.assert_array_equal(target, 0.0)


@given(st.integers(0, 2**32), st.integers(0, 40), st.booleans())
def test_a_stream_of_random_numbers_goes_on_where_it_stood(seed: int, drawn: int, half: bool) -> None:
    stream, other = np.random.default_rng(seed), np.random.default_rng(0)
    stream.standard_normal(drawn)
    if half:
        stream.integers(0, 10, dtype=np.uint32)  # leaves half of a 64-bit word for the next time
    set_random_state(other, unpack(pack(random_state(stream))))
    np.testing.assert_array_equal(
        stream.integers(0, 100, 9, dtype=np.uint32), other.integers(0, 100, 9, dtype=np.uint32)
    )
    np.testing.assert_array_equal(stream.standard_normal(9), other.standard_normal(9))


@settings(max_examples=40)
@given(st.integers(0, 2 * TICKS_AHEAD + 2), st.integers(0, 5))
def test_noise_goes_on_where_it_stood(drawn: int, before: int) -> None:
    """Also at the very start, at the end of what was drawn ahead, and in a noise that was used already."""
    noise, other = (SensorNoise(np.array([1.0, 0.5]), 3, 2) for _ in range(2))
    for _ in range(drawn):
        noise.draw()
    for _ in range(before):
        other.draw()
    other.restore(unpack(pack(noise.state())))
    for _ in range(TICKS_AHEAD + 2):
        np.testing.assert_array_equal(noise.draw(), other.draw())


# Motor drivers and what they do by themselves

ARMS, JOINTS, DT_S = 2, 3, 0.01
START = np.array([[1.0, -2.0, 0.5], [0.0, 3.0, -1.0]])
BEHAVIOURS: tuple[Callable[[], Behaviour], ...] = (Limp, Brake, Release, lambda: Release(0.6), lambda: LetDown(0.05))

arm_numbers = st.integers(0, ARMS - 1)
deeds = st.one_of(
    st.tuples(st.just("command"), arm_numbers, st.lists(st.floats(-50, 50), min_size=6, max_size=6)),
    st.tuples(st.just("leave"), arm_numbers, st.integers(0, len(BEHAVIOURS) - 1)),
    st.tuples(st.just("regain"), arm_numbers, st.none()),
    st.tuples(st.just("step"), st.integers(1, 8), st.none()),
)


def felt(step: int) -> Felt:
    """Arms that move, so that a behaviour's start and elapsed time show."""
    wave = np.sin(0.1 * step + np.arange(ARMS * JOINTS)).reshape(ARMS, JOINTS)
    return Felt(wave, 2.0 * wave, 3.0 * wave, 4.0 * wave, 5.0 * wave)


def drivers(delay_ticks: int) -> MotorDrivers:
    return MotorDrivers(START, np.array([40.0, 30.0, 20.0]), 1000.0, np.array([9.0, 9.0, 3.0]), delay_ticks)


def carry_out(motors: MotorDrivers, plan: list[Any], start: int) -> tuple[list[Array], int]:
    seen, now = [], start
    for what, arm, value in plan:
        if what == "command":
            motors.command(arm, value[:3], value[3:])
        elif what == "leave":
            motors.leave_to(arm, BEHAVIOURS[value]())
        elif what == "regain":
            motors.regain(arm)
        else:
            for _ in range(arm):
                motors.tick()
                motors.advance(DT_S, felt(now))
                opened = np.array(motors.newly_open(), dtype=float)
                seen += [motors.torque.copy(), motors.base_force.copy(), motors.age_ticks.astype(float), opened]
                now += 1
    return seen, now


@given(st.lists(deeds, max_size=12), st.lists(deeds, max_size=12), st.integers(0, 2))
def test_motor_drivers_go_on_as_those_that_they_were_taken_from(
    before: list[Any], after: list[Any], delay: int
) -> None:
    first, other = drivers(delay), drivers(delay)
    between_ticks = [*before, ("step", 1, None)]
    _, now = carry_out(first, between_ticks, 0)
    other.restore(unpack(pack(first.state())))
    rest = [*after, ("step", 5, None)]
    expected, _ = carry_out(first, rest, now)
    got, _ = carry_out(other, rest, now)
    for one, two in zip(expected, got, strict=True):
        np.testing.assert_array_equal(one, two)


def test_motor_drivers_of_another_team_are_refused() -> None:
    saved = drivers(0).state()
    for change in ({"torque": np.zeros((3, 3))}, {"ages": [0]}, {"unled": [[7, {"kind": "limp"}]]}):
        with pytest.raises(SnapshotError):
            drivers(0).restore(saved | change)
    with pytest.raises(SnapshotError, match="juggle"):
        drivers(0).restore(saved | {"unled": [[0, {"kind": "juggle"}]]})
    with pytest.raises(ValueError, match="argument 2"):  # of zip: more commands on the way than the delay has ticks
        drivers(0).restore(saved | {"on_the_way": deque([np.zeros((2, 6))])})
