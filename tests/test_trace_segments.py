"""The trace is one whole file whatever happened while its rows were written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_server.trace import BLOCK_ROWS, TraceWriter, columns, read_trace
from sim_server.trace_rows import RowsLost, Segment

Array = NDArray[np.float64]


def rows(arms: Sequence[str], first: int, count: int) -> Array:
    """Rows that all differ; tick and age are whole numbers."""
    named = columns(arms, 7)
    block = np.random.default_rng(first).standard_normal((count, sum(named.values())))
    block[:, 0] = np.arange(first, first + count)
    ends = np.cumsum(list(named.values()))
    for (name, _), end in zip(named.items(), ends, strict=True):
        if name.endswith("age_ticks"):
            block[:, end - 1] = np.arange(count) % 3
    return block


def write(trace: TraceWriter, block: Array, flush_every: int = 10**9) -> None:
    for k, row in enumerate(block):
        trace.append([row[:5], row[5:]])
        if k % flush_every == 0:
            trace.flush()


def whole(folder: Path, block: Array) -> bytes:
    folder.mkdir()
    trace = TraceWriter(folder / "trace.parquet", ("a1", "a2"), 7)
    write(trace, block)
    trace.close()
    trace.forget()
    assert [path.name for path in folder.iterdir()] == ["trace.parquet"]
    return (folder / "trace.parquet").read_bytes()


@settings(max_examples=12)  # each writes two files of 60 columns
@given(kept=st.integers(0, 50), lost=st.integers(0, 30), torn=st.integers(0, 100))
def test_a_trace_that_was_cut_anywhere_and_gone_on_with_is_the_one_that_was_not(
    tmp_path_factory: pytest.TempPathFactory, kept: int, lost: int, torn: int
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    block = rows(("a1", "a2"), 0, 60)
    first = TraceWriter(folder / "trace.parquet", ("a1", "a2"), 7)
    write(first, block[:kept])
    segments = first.flush()
    write(first, rows(("a1", "a2"), 99, lost))
    first.flush()
    with (folder / "trace.parts" / "0001.rows").open("ab") as file:
        file.write(bytes(torn))  # a row that the system had in part
    again = TraceWriter(folder / "trace.parquet", ("a1", "a2"), 7, segments)
    write(again, block[kept:])
    again.close()
    assert (folder / "trace.parquet").read_bytes() == whole(folder / "whole", block)


def test_the_bytes_do_not_tell_how_often_the_rows_were_handed_over(tmp_path: Path) -> None:
    block = rows(("a1", "a2"), 0, 2 * BLOCK_ROWS + 10)
    trace = TraceWriter(tmp_path / "trace.parquet", ("a1", "a2"), 7)
    write(trace, block, flush_every=7)
    trace.close()
    assert (tmp_path / "trace.parquet").read_bytes() == whole(tmp_path / "whole", block)
    assert pq.ParquetFile(tmp_path / "trace.parquet").num_row_groups == 3


def test_an_arm_that_was_absent_has_no_numbers_there_and_a_null_age(tmp_path: Path) -> None:
    trace = TraceWriter(tmp_path / "trace.parquet", ("a1", "a2"), 7)
    early, later = rows(("a1", "a2"), 0, 4), rows(("a1", "a3"), 4, 3)
    write(trace, early)
    trace.segment(("a1", "a2"))  # nobody came or went
    trace.segment(("a1", "a3"))
    write(trace, later)
    assert trace.flush() == [Segment(("a1", "a2"), 4), Segment(("a1", "a3"), 3)]
    trace.close()
    found = read_trace(tmp_path / "trace.parquet")
    assert list(found) == list(columns(("a1", "a2", "a3"), 7))
    np.testing.assert_array_equal(found["tick"], np.arange(7))
    np.testing.assert_array_equal(found["a1.q"], np.vstack([early[:, 24:31], later[:, 24:31]]))
    assert np.isnan(found["a2.q"][4:]).all()
    assert np.isnan(found["a3.grip"][:4]).all()
    np.testing.assert_array_equal(found["a2.age_ticks"], [0, 1, 2, 0, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(found["a3.age_ticks"], [*[np.nan] * 4, 0, 1, 2])
    assert pq.read_table(tmp_path / "trace.parquet").column("a3.age_ticks").null_count == 4
    assert found["a1.age_ticks"].dtype == np.int64


def test_a_trace_of_several_segments_goes_on_in_the_last_and_drops_those_that_began_later(tmp_path: Path) -> None:
    trace = TraceWriter(tmp_path / "trace.parquet", ("a1",), 7)
    write(trace, rows(("a1",), 0, 3))
    trace.segment(("a1", "a2"))
    write(trace, rows(("a1", "a2"), 3, 2))
    kept = trace.flush()
    write(trace, rows(("a1", "a2"), 90, 2))
    trace.segment(("a2",))
    write(trace, rows(("a2",), 95, 2))
    trace.flush()
    again = TraceWriter(tmp_path / "trace.parquet", (), 7, kept)
    assert sorted(path.name for path in (tmp_path / "trace.parts").iterdir()) == ["0001.rows", "0002.rows"]
    write(again, rows(("a1", "a2"), 5, 1))
    again.close()
    np.testing.assert_array_equal(read_trace(tmp_path / "trace.parquet")["tick"], np.arange(6))


@pytest.mark.parametrize(
    ("segment", "said"),
    [
        (Segment(("a1", "a2"), 4), "expected at least"),
        (Segment(("a1", "a3"), 3), "a3"),
        (Segment(("a1",), 3), "a2"),
    ],
)
def test_rows_that_are_not_there_are_named_and_nothing_is_changed(tmp_path: Path, segment: Segment, said: str) -> None:
    trace = TraceWriter(tmp_path / "trace.parquet", ("a1", "a2"), 7)
    write(trace, rows(("a1", "a2"), 0, 3))
    trace.flush()
    file = tmp_path / "trace.parts" / "0001.rows"
    before = file.read_bytes()
    with pytest.raises(RowsLost, match=r"0001\.rows") as error:
        TraceWriter(tmp_path / "trace.parquet", (), 7, [segment])
    assert said in str(error.value)
    with pytest.raises(RowsLost, match=r"0002\.rows cannot be read"):
        TraceWriter(tmp_path / "trace.parquet", (), 7, [Segment(("a1", "a2"), 3), Segment(("a1",), 1)])
    assert file.read_bytes() == before
