"""A person's wishes: what keys and sticks mean, how they reach the leader; none pulls too hard, or upwards."""

from __future__ import annotations

import math
import threading
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from played_simulator import DEADLINE_S, PlayedSimulator, wait_for

from agents.leader import LeaderSettings, pull, run_leader
from agents.person import Person
from agents.wish import MAX_LINE, NoWish, Wish
from deploy.person.keys import Keys
from deploy.person.stick import DEAD, stick_wish
from wire.codec import decode, decode_any, encode
from wire.memory import MemoryQuestion
from wire.messages import End, Goodbye, LeaderForce, LeaderView, Refusal, Welcome

POINT_O = np.array([0.8, 0.0, 0.7])
SETTINGS = LeaderSettings("test", (2.0, 0.0), force_max_N=40.0, damping_Ns_m=320.0)
PARTS = st.floats(-1.0, 1.0)
WISHES = st.one_of(
    st.builds(Wish, st.tuples(PARTS, PARTS)), st.just(Wish(brake=True)), st.just(Wish(leave=True)), st.just(Wish())
)
SPEEDS = st.floats(-1e3, 1e3)


def view(velocity: tuple[float, float, float] = (0.0,) * 3, turning: tuple[float, ...] = (0.0,) * 3) -> LeaderView:
    return LeaderView(10, 10_000_000, (0.3, 0.2, 0.1), (1.0, 0.0, 0.0, 0.0), velocity, (turning[0], *turning[1:3]))


def wanted(typed: bytes) -> Wish:
    """The last wish of these keys."""
    *_, last = [Wish(), *Keys().typed(typed)]
    return last


# No wish pulls harder than the bound, or out of the plane.


@given(WISHES, st.tuples(SPEEDS, SPEEDS, SPEEDS), st.tuples(SPEEDS, SPEEDS, SPEEDS), st.floats(0.0, 1e4))
def test_no_wish_pulls_harder_than_the_bound_or_upwards(
    wish: Wish, velocity: tuple[float, float, float], turning: tuple[float, float, float], force_max_N: float
) -> None:
    settings = LeaderSettings("test", (2.0, 0.0), force_max_N=force_max_N)
    force = pull(view(velocity, turning), POINT_O, settings, wish)
    assert force.shape == (3,)
    assert force[2] == 0.0
    assert np.linalg.norm(force) <= force_max_N, "no tolerance: the simulator refuses what is above"


@given(st.binary(max_size=60))
def test_whatever_is_typed_pulls_within_the_bound(typed: bytes) -> None:
    for wish in Keys().typed(typed):
        assert np.linalg.norm(pull(view(), POINT_O, SETTINGS, wish)) <= 40.0


@given(st.floats(), st.floats())
def test_whatever_a_stick_gives_pulls_within_the_bound(right: float, down: float) -> None:
    assert np.linalg.norm(pull(view(), POINT_O, SETTINGS, stick_wish(right, down))) <= 40.0


@given(PARTS, PARTS)
def test_a_wish_is_pulled_in_its_very_direction_wherever_the_load_is_and_goes(x: float, y: float) -> None:
    force = pull(view((0.5, -0.2, 0.0)), POINT_O, SETTINGS, Wish((x, y)))
    assert force[0] * y == pytest.approx(force[1] * x, abs=1e-9)
    assert np.hypot(force[0], force[1]) == pytest.approx(40.0 * min(1.0, math.hypot(x, y)), abs=1e-9)


def test_to_brake_is_to_pull_against_the_motion_of_the_point_and_nothing_at_rest() -> None:
    np.testing.assert_array_equal(pull(view(), POINT_O, SETTINGS, Wish(brake=True)), 0.0)
    # The load turns by 0.1 rad/s: the point, 0.8 m ahead, goes left by 0.08 m/s, beside the 0.05 m/s ahead of all.
    slowly = pull(view((0.05, 0.0, 0.0), (0.0, 0.0, 0.1)), POINT_O, SETTINGS, Wish(brake=True))
    np.testing.assert_allclose(slowly, [-16.0, -25.6, 0.0], atol=1e-12)
    fast = pull(view((3.0, 0.0, 0.0)), POINT_O, SETTINGS, Wish(brake=True))
    np.testing.assert_allclose(fast, [-40.0, 0.0, 0.0], rtol=1e-9)


# Keys


@pytest.mark.parametrize(
    ("keys", "ahead", "left"),
    [
        ((b"w", b"W", b"8", b"\x1b[A", b"\x1bOA", b"\x1b[1;2A"), 1.0, 0.0),
        ((b"s", b"S", b"2", b"\x1b[B", b"\x1bOB"), -1.0, 0.0),
        ((b"a", b"A", b"4", b"\x1b[D", b"\x1bOD"), 0.0, 1.0),
        ((b"d", b"D", b"6", b"\x1b[C", b"\x1bOC"), 0.0, -1.0),
        ((b"7",), math.sqrt(0.5), math.sqrt(0.5)),
        ((b"9",), math.sqrt(0.5), -math.sqrt(0.5)),
        ((b"1",), -math.sqrt(0.5), math.sqrt(0.5)),
        ((b"3",), -math.sqrt(0.5), -math.sqrt(0.5)),
    ],
)
def test_a_key_of_a_direction_pulls_there_by_half_of_the_largest_pull(
    keys: tuple[bytes, ...], ahead: float, left: float
) -> None:
    for key in keys:
        assert wanted(key).share == pytest.approx((0.5 * ahead, 0.5 * left))


def test_plus_and_minus_change_the_pull_by_tenths_between_a_tenth_and_all() -> None:
    assert wanted(b"w++").share == pytest.approx((0.7, 0.0))
    assert wanted(b"++w").share == pytest.approx((0.7, 0.0))
    assert wanted(b"w" + 20 * b"+").share == (1.0, 0.0)
    assert wanted(b"w" + 20 * b"-").share == (0.1, 0.0)
    assert wanted(b"a+ d").share == pytest.approx((0.0, -0.6)), "it stays as strong for the next direction"


def test_space_lets_go_b_brakes_q_leaves() -> None:
    assert wanted(b"w ") == wanted(b"w5") == Wish()
    assert wanted(b"wb") == Wish(brake=True)
    assert wanted(b"wq") == Wish(leave=True)
    assert wanted(b"w +") == Wish(), "harder is no pull as long as there is no direction"


@given(st.binary(max_size=40), st.lists(st.integers(0, 40)))
def test_keys_mean_the_same_however_their_bytes_are_cut(typed: bytes, cuts: list[int]) -> None:
    at = [0, *sorted(cut for cut in cuts if cut < len(typed)), len(typed)]
    pieces = [typed[start:end] for start, end in pairwise(at)]
    keys = Keys()
    assert [wish for piece in pieces for wish in keys.typed(piece)] == list(Keys().typed(typed))


@given(st.binary(max_size=40).filter(lambda typed: not set(typed) & set(b"wasdWASD12346789bBqQABCDO[ 5+-=_")))
def test_other_keys_mean_nothing(typed: bytes) -> None:
    assert list(Keys().typed(typed)) == []


def test_a_key_that_changes_nothing_is_no_new_wish() -> None:
    assert len(list(Keys().typed(b"wwww"))) == 1


# A stick


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_stick_pulls_where_it_is_pushed_and_not_at_all_near_its_middle(right: float, down: float) -> None:
    wish, pushed = stick_wish(right, down), math.hypot(right, down)
    if pushed <= DEAD:
        assert wish == Wish()
        return
    # Rounded to 64ths of each part.
    assert wish.share == pytest.approx(
        tuple(-each / pushed * (min(pushed, 1.0) - DEAD) / (1.0 - DEAD) for each in (down, right)), abs=1 / 128 + 1e-12
    )


def test_a_stick_at_its_end_pulls_by_all_and_at_the_edge_of_the_dead_zone_by_next_to_nothing() -> None:
    assert stick_wish(0.0, -1.0) == Wish((1.0, 0.0))
    assert stick_wish(1.0, 0.0) == Wish((0.0, -1.0))
    assert math.hypot(*stick_wish(0.0, DEAD + 0.01).share) < 0.02
    assert stick_wish(math.nan, 1.0) == stick_wish(math.inf, 0.0) == Wish()
    assert stick_wish(1.0, 1.0, brake=True) == Wish(brake=True)
    assert stick_wish(1.0, 1.0, brake=True, leave=True) == Wish(leave=True)


# Lines


@given(WISHES)
def test_a_wish_is_the_same_after_its_line(wish: Wish) -> None:
    line = wish.line()
    assert line.endswith(b"\n")
    assert len(line) <= MAX_LINE
    assert Wish.read(line) == wish


@pytest.mark.parametrize(
    "line", [b"", b"pull", b"pull 1", b"pull 1 2 3", b"pull a b", b"pull nan 0", b"pull inf 0", b"go"]
)
def test_a_line_that_is_no_wish_is_refused(line: bytes) -> None:
    with pytest.raises(NoWish):
        Wish.read(line)
    with pytest.raises(NoWish):
        Wish.read(b"pull 1.01 0")


def test_a_wish_is_told_to_people_in_newtons() -> None:
    assert Wish((0.5, 0.0)).says(40.0) == "pull 20 N ↑"
    assert Wish((-1.0, -1.0)).says(40.0) == "pull 40 N ↘"
    assert Wish((-0.5, 1e-9)).says(40.0) == "pull 20 N ↓"
    assert [Wish().says(40.0), Wish(brake=True).says(40.0), Wish(leave=True).says(40.0)] == [
        "let go",
        "braking",
        "leaving",
    ]


# The person


@given(st.lists(WISHES, max_size=6), st.lists(st.integers(0, 300)))
def test_the_newest_whole_line_counts_however_it_arrives(wishes: list[Wish], cuts: list[int]) -> None:
    said = b"".join(wish.line() for wish in wishes) + b"pull 1"
    at = [0, *sorted(cut for cut in cuts if cut < len(said)), len(said)]
    person = Person(lambda: None)
    for start, end in pairwise(at):
        person.hear(said[start:end])
    left = next((wish for wish in wishes if wish.leave), None)
    assert person.wish == (left or (wishes[-1] if wishes else Wish()))


@given(st.binary(max_size=500))
def test_noise_ends_nothing_and_is_not_kept(noise: bytes) -> None:
    person = Person(lambda: None)
    for _ in range(10):
        person.hear(noise)
    person.hear(b"\nbrake\n")
    assert person.wish.brake or person.wish.leave
    assert len(person._rest) <= 2 * MAX_LINE


def test_a_person_who_goes_before_the_leader_is_in_ends_it_at_once_and_once() -> None:
    ended: list[int] = []
    person = Person(lambda: ended.append(1))
    person.hear(b"leave\nleave\n")
    person.hear_end()
    assert ended == [1]


def test_who_is_gone_without_a_word_has_left() -> None:
    person = Person(lambda: None)
    person.hear(b"pull 1 0\n")
    person.hear_end()
    assert person.wish == Wish(leave=True)
    assert person.departure.wanted is False  # nobody heard it


# The leader that obeys


class Led(PlayedSimulator):
    """A simulator whose leader obeys a person; it keeps what was asked of it."""

    def __init__(self) -> None:
        self.asked: list[bytes] = []
        super().__init__("lock-step")
        self.ends = threading.Event()
        self.person = Person(self.ends.set)
        link = self.broker.link()
        self.start(lambda: run_leader(link, SETTINGS, self.person))
        wait_for(self.view.matched)

    def _answer(self, question: MemoryQuestion, reply: Welcome | Refusal) -> None:
        self.asked.append(question.payload)
        super()._answer(question, reply)

    def force(self, tick: int) -> tuple[float, ...]:
        message = LeaderView(tick, tick * 1_000_000, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)
        self.view.put(encode(message))
        answer = decode(self.answers.get(timeout=DEADLINE_S), LeaderForce)
        assert answer.tick == tick
        return answer.force


def test_the_leader_pulls_as_the_newest_wish_says_and_says_goodbye_when_the_person_leaves() -> None:
    simulator = Led()
    assert simulator.force(10) == (0.0, 0.0, 0.0), "it does not pull before it is told to"
    simulator.person.hear(b"pull 0.5 0\npull 0 0.25\n")
    assert simulator.force(20) == pytest.approx((0.0, 10.0, 0.0))
    assert simulator.force(30) == pytest.approx((0.0, 10.0, 0.0)), "a wish holds until the next"
    simulator.person.hear(b"leave\n")
    assert simulator.ended.get(timeout=DEADLINE_S) == "left"
    assert isinstance(decode_any(simulator.asked[-1]), Goodbye)
    assert not simulator.ends.is_set()


def test_the_run_s_end_is_the_end_also_for_a_person() -> None:
    simulator = Led()
    simulator.view.put(encode(End("over", "the run is over")))
    assert simulator.ended.get(timeout=DEADLINE_S) == "the run is over"
