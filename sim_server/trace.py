"""trace.parquet: one row per recorded tick, written in blocks while the run goes on.

Columns: ``tick``, ``time_s``, ``load.position`` (3), ``load.quat_wxyz`` (4), ``load.linear_velocity`` (3),
``load.angular_velocity`` (3), ``leader.force`` (3), and for every arm ``a1.q`` (n), ``a1.qd`` (n), ``a1.tau`` (n,
applied), ``a1.wrench`` (6), ``a1.stiffness`` (n), ``a1.base`` (3: x, y, yaw in the world), ``a1.base_velocity`` (3),
``a1.base_force`` (3, applied, frame B), ``a1.grip`` (6: what the hand exerts on the load at the grasp, world) and
``a1.age_ticks``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCK_ROWS = 1000


def columns(arms: Iterable[str], joints: int) -> dict[str, int]:
    """Name and width of every column, in order."""
    named = {
        "tick": 1,
        "time_s": 1,
        "load.position": 3,
        "load.quat_wxyz": 4,
        "load.linear_velocity": 3,
        "load.angular_velocity": 3,
        "leader.force": 3,
    }
    for arm in arms:
        named |= {
            f"{arm}.q": joints,
            f"{arm}.qd": joints,
            f"{arm}.tau": joints,
            f"{arm}.wrench": 6,
            f"{arm}.stiffness": joints,
            f"{arm}.base": 3,
            f"{arm}.base_velocity": 3,
            f"{arm}.base_force": 3,
            f"{arm}.grip": 6,
            f"{arm}.age_ticks": 1,
        }
    return named


class TraceWriter:
    """Collects rows and writes them block by block; the file is whole after :meth:`close`."""

    def __init__(self, path: Path, arms: Iterable[str], joints: int) -> None:
        self._path, self._joints = path, joints
        self._parts: list[Path] = []
        self._begin(arms)

    def _begin(self, arms: Iterable[str]) -> None:
        part = self._path.with_suffix(f".{len(self._parts) + 1}.part") if self._parts else self._path
        self._columns = columns(arms, self._joints)
        self._schema = pa.schema([(name, _type(name, width)) for name, width in self._columns.items()])
        self._writer: Any = pq.ParquetWriter(part, self._schema, compression="zstd")
        self._parts.append(part)
        self._block = np.empty((BLOCK_ROWS, sum(self._columns.values())))
        self._filled = 0

    def segment(self, arms: Iterable[str]) -> None:
        """From the next row on, these arms are there."""
        self._finish()
        self._begin(arms)

    def _finish(self) -> None:
        if self._filled:
            self._flush()
        self._writer.close()

    def append(self, parts: list[Array]) -> None:
        """One row: the values of all columns in order, in pieces of any length."""
        np.concatenate(parts, out=self._block[self._filled])
        self._filled += 1
        if self._filled == BLOCK_ROWS:
            self._flush()

    def _flush(self) -> None:
        arrays, start = [], 0
        for name, width in self._columns.items():
            values = self._block[: self._filled, start : start + width]
            start += width
            flat = pa.array(np.ascontiguousarray(values).ravel())
            if width > 1:
                arrays.append(pa.FixedSizeListArray.from_arrays(flat, width))
            else:
                arrays.append(flat.cast(_type(name, width)))
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))
        self._filled = 0

    def close(self) -> None:
        """Write what is left and finish the file."""
        self._finish()
        if len(self._parts) == 1:
            return
        tables = [pq.read_table(part) for part in self._parts]
        pq.write_table(pa.concat_tables(tables, promote_options="default"), self._path, compression="zstd")
        for part in self._parts[1:]:
            part.unlink()


def _type(name: str, width: int) -> Any:
    if width > 1:
        return pa.list_(pa.float64(), width)
    return pa.float64() if name == "time_s" else pa.int64()


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
