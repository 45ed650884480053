"""trace.parquet: one row per recorded tick, made at the end from the rows that were written while the run went on.

A Parquet file is worth nothing before its end is written, and a simulator that is killed writes no end. So the rows go
to ``trace.parts/0001.rows`` first (sim_server/trace_rows.py), and a new file begins whenever other arms take part.

What the columns are: sim_server/trace_columns.py.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from sim_server.disk import Disk, Do, at_once
from sim_server.trace_columns import columns as columns
from sim_server.trace_rows import RowFile, Segment

Array = NDArray[np.float64]

BLOCK_ROWS = 1000


class TraceWriter:
    """Writes the rows of a run, segment by segment; the trace is there after :meth:`close`.

    Args:
        path: of the trace. Its rows go to the folder ``<path without its ending>.parts`` until then.
        arms: who takes part from the first row on.
        joints: of an arm.
        segments: of a run that goes on: what is kept. Rows that were written after those are dropped.
        disk: writes the rows; without one they are written at once.
    """

    def __init__(
        self,
        path: Path,
        arms: Iterable[str],
        joints: int,
        segments: Sequence[Segment] = (),
        disk: Disk | None = None,
    ) -> None:
        self._path, self._parts, self._joints, self._disk = path, path.with_suffix(".parts"), joints, disk
        self._do: Do = disk.do if disk else at_once
        self._files = [
            RowFile.kept(self._file(k), segment, self._width(segment), self._do) for k, segment in _count(segments)
        ]
        if segments:
            for file in self._parts.glob("*.rows"):
                if file not in [each.path for each in self._files]:
                    file.unlink()
        else:
            self._parts.mkdir()
            self._begin(tuple(arms))

    def _file(self, number: int) -> Path:
        return self._parts / f"{number:04}.rows"

    def _width(self, segment: Segment) -> int:
        return sum(columns(segment.arms, self._joints).values())

    def _begin(self, arms: tuple[str, ...]) -> None:
        segment = Segment(arms, 0)
        self._files.append(RowFile(self._file(len(self._files) + 1), segment, self._width(segment), self._do))

    def segment(self, arms: Iterable[str]) -> None:
        """From the next row on, these arms take part and no others."""
        arms = tuple(arms)
        if arms != self._files[-1].arms:
            self._files[-1].close()
            self._begin(arms)

    def append(self, parts: list[Array]) -> None:
        """One row: the values of all columns in order, in pieces of any length."""
        self._files[-1].append(parts)

    def segments(self) -> list[Segment]:
        """What there is so far."""
        return [Segment(file.arms, file.rows) for file in self._files]

    def flush(self) -> list[Segment]:
        """Have all rows so far handed to the system, which keeps them if this process is killed; what there is."""
        self._files[-1].flush()
        return self.segments()

    def close(self) -> None:
        """Make the trace of all segments, whole or not at all. The rows stay until :meth:`forget`.

        Raises:
            DiskFailed: rows could not be written.
        """
        self._files[-1].close()
        if self._disk is not None:
            self._disk.wait()
        together = columns(dict.fromkeys(arm for file in self._files for arm in file.arms), self._joints)
        schema = pa.schema([(name, _type(name, width)) for name, width in together.items()])
        part = self._path.with_suffix(".part")
        with pq.ParquetWriter(part, schema, compression="zstd") as writer:
            for block in _blocks(_in(together, columns(file.arms, self._joints), file) for file in self._files):
                writer.write_table(pa.Table.from_arrays(_arrays(together, block), schema=schema))
        os.replace(part, self._path)

    def forget(self) -> None:
        """Remove the rows: the trace has them."""
        shutil.rmtree(self._parts)


def _count(segments: Sequence[Segment]) -> Iterator[tuple[int, Segment]]:
    return enumerate(segments, start=1)


def _in(together: Mapping[str, int], own: Mapping[str, int], file: RowFile) -> Iterator[Array]:
    """A segment's rows, block by block, with columns of all segments: NaN where it has none."""
    starts = dict(zip(own, np.cumsum([0, *own.values()]).tolist(), strict=False))
    source = [starts[name] + k if name in own else -1 for name, width in together.items() for k in range(width)]
    for block in file.read(BLOCK_ROWS):
        padded = np.column_stack([block, np.full(len(block), np.nan)])
        yield padded[:, source]


def _blocks(segments: Iterable[Iterator[Array]]) -> Iterator[Array]:
    """The rows of all segments in blocks of one size, so that the trace does not tell how they were written."""
    waiting: list[Array] = []
    for segment in segments:
        for rows in segment:
            waiting.append(rows)
            while sum(map(len, waiting)) >= BLOCK_ROWS:
                whole = np.concatenate(waiting)
                yield whole[:BLOCK_ROWS]
                waiting = [whole[BLOCK_ROWS:]]
    if any(map(len, waiting)):
        yield np.concatenate(waiting)


def _arrays(named: Mapping[str, int], block: Array) -> list[Any]:
    arrays, start = [], 0
    for name, width in named.items():
        values = np.ascontiguousarray(block[:, start : start + width]).ravel()
        start += width
        if width > 1:
            arrays.append(pa.FixedSizeListArray.from_arrays(pa.array(values), width))
        else:
            arrays.append(pa.array(values, from_pandas=True).cast(_type(name, width)))  # a NaN becomes a null
    return arrays


def _type(name: str, width: int) -> Any:
    if width > 1:
        return pa.list_(pa.float64(), width)
    return pa.int64() if name == "tick" or name.endswith(".age_ticks") else pa.float64()


def read_trace(path: Path) -> Mapping[str, NDArray[Any]]:
    """All columns as arrays: (rows,) or (rows, width).

    Raises:
        OSError, pyarrow.ArrowInvalid: there is no such file, or it is not whole.
    """
    table = pq.read_table(path)
    found: dict[str, NDArray[Any]] = {}
    for field in table.schema:
        column = table.column(field.name).combine_chunks()
        if not pa.types.is_fixed_size_list(field.type):
            found[field.name] = column.to_numpy(zero_copy_only=False)  # with NaN where there is nothing
            continue
        rows: NDArray[Any] = np.full((len(column), field.type.list_size), np.nan)
        rows[np.asarray(column.is_valid())] = np.asarray(column.flatten()).reshape(-1, field.type.list_size)
        found[field.name] = rows
    return found
