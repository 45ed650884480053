"""Wall times are kept as counts: the percentiles are right to a percent, and a long run takes no more memory."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sim_server.durations import Durations
from sim_server.snapshot import pack, unpack


def counted(values: list[int]) -> Durations:
    found = Durations()
    for value in values:
        found.append(value)
    return found


@given(st.lists(st.integers(0, 10**12), min_size=1, max_size=200), st.sampled_from([1.0, 50.0, 99.0, 100.0]))
def test_a_percentile_is_numpys_to_a_percent_below(values: list[int], percent: float) -> None:
    exact = int(np.percentile(values, percent, method="inverted_cdf"))
    # Eight leading binary digits are kept: less than 1/128 is cut off, and nothing below 256 ns.
    assert exact * (1 - 1 / 128) <= counted(values).percentile_ns(percent) <= exact


def test_the_longest_is_kept_as_it_was_and_none_is_zero() -> None:
    assert counted([1_000_003, 7]).max_ns == 1_000_003
    assert (counted([]).percentile_ns(99), len(counted([])), counted([]).max_ns) == (0, 0, 0)


def test_memory_goes_by_the_range_of_the_values_and_not_by_their_number() -> None:
    rng = np.random.default_rng(1)
    # From 1 us to 16 ms is fourteen doublings of 128 values each.
    found = counted([int(value) for value in 1e3 * 2 ** rng.uniform(0, 14, size=200_000)])
    assert len(found) == 200_000
    assert found.told_apart <= 15 * 128


@given(st.lists(st.integers(0, 10**12), max_size=100), st.lists(st.integers(0, 10**12), max_size=100))
def test_counting_goes_on_from_what_was_saved(before: list[int], after: list[int]) -> None:
    resumed = counted([3])  # whatever it held is gone
    resumed.restore(unpack(pack(counted(before).state())))
    for value in after:
        resumed.append(value)
    whole = counted(before + after)
    assert (len(resumed), resumed.max_ns) == (len(whole), whole.max_ns)
    assert [resumed.percentile_ns(p) for p in range(0, 101, 10)] == [whole.percentile_ns(p) for p in range(0, 101, 10)]
