"""What the writing thread promises: everything, in order, up to the first thing that fails, which is told."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from sim_server.disk import MOST_WAITING, Disk, DiskFailed
from sim_server.trace_rows import HANDED_OVER_BYTES, RowFile, Segment

DEADLINE_S = 10.0


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    """Something that a job can wait at; open in the end."""
    event = threading.Event()
    yield event
    event.set()


def fail(gate: threading.Event) -> None:
    gate.wait(DEADLINE_S)
    raise OSError("no room")


def test_things_are_done_in_order_by_another_thread_and_waiting_waits_for_all() -> None:
    disk, done, workers = Disk(), list[int](), set[int]()

    def note(k: int) -> None:
        done.append(k)
        workers.add(threading.get_ident())

    for k in range(100):
        disk.do(partial(note, k))
    disk.wait()
    assert done == list(range(100))
    assert len(workers) == 1
    assert threading.get_ident() not in workers
    assert len(disk.took_ns) == 100


def test_after_the_first_failure_nothing_is_done_and_everybody_is_told(gate: threading.Event) -> None:
    """What was handed over behind it is not done either: else a checkpoint could be on the disk without its rows."""
    disk, done = Disk(), list[int]()
    disk.do(partial(done.append, 1))
    disk.do(partial(fail, gate))
    disk.do(partial(done.append, 2))
    gate.set()
    for _ in range(2):
        with pytest.raises(DiskFailed, match="no room"):
            disk.wait()
        with pytest.raises(DiskFailed, match="no room"):
            disk.do(partial(done.append, 3))
    assert done == [1]


def test_nobody_waits_for_a_slow_disk_until_a_good_deal_is_on_the_way(gate: threading.Event) -> None:
    disk, under_way, passed = Disk(), threading.Event(), threading.Event()

    def first() -> None:
        under_way.set()
        gate.wait(DEADLINE_S)

    disk.do(first)
    assert under_way.wait(DEADLINE_S)
    for _ in range(MOST_WAITING):
        disk.do(lambda: None)

    def one_more() -> None:
        disk.do(lambda: None)
        passed.set()

    threading.Thread(target=one_more, daemon=True).start()
    assert not passed.wait(0.05), "the next one waits, so that memory does not fill up"
    gate.set()
    assert passed.wait(DEADLINE_S)
    disk.wait()


def test_waiting_for_nothing_returns() -> None:
    Disk().wait()


def test_rows_are_written_as_they_were_when_they_were_handed_over(tmp_path: Path, gate: threading.Event) -> None:
    """Rows that come while earlier ones are on their way change nothing of those."""
    disk = Disk()
    disk.do(partial(gate.wait, DEADLINE_S))
    file = RowFile(tmp_path / "0001.rows", Segment(("a1",), 0), 100, disk.do)
    count = 2 * HANDED_OVER_BYTES // 800
    for k in range(count):
        file.append([np.full(60, float(k)), np.full(40, -float(k))])
        if k % 500 == 0:
            file.flush()
    file.close()
    gate.set()
    disk.wait()
    found = np.concatenate(list(file.read(1000)))
    np.testing.assert_array_equal(found[:, 0], np.arange(count))
    np.testing.assert_array_equal(found[:, 99], -np.arange(count))
