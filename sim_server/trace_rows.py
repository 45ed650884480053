"""Rows of numbers in a file that is worth something at any length: a line that says what they are, then the rows.

The line is JSON, ``{"arms": ["a1", "a2"], "width": 110}``; a row is ``width`` numbers, little-endian float64.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_server.disk import Do, at_once
from sim_server.errors import SimError

Array = NDArray[np.float64]

HANDED_OVER_BYTES = 1 << 20
"""Rows that are kept in memory before they are written."""
NUMBER = 8
"""Bytes of a number."""


class RowsLost(SimError):
    """Rows that a run needs to go on are not in its folder."""


@dataclass(frozen=True, slots=True)
class Segment:
    """Rows in which the same arms take part."""

    arms: tuple[str, ...]
    rows: int


class RowFile:
    """The rows of one segment, open for more.

    Args:
        path: of a file that is not there yet.
        width: numbers in a row.
        do: how rows are written: in order.
    """

    def __init__(self, path: Path, segment: Segment, width: int, do: Do = at_once) -> None:
        self._set(path, segment, width, do)
        self._file: Any = path.open("xb", buffering=0)
        self._waiting += self._head

    def _set(self, path: Path, segment: Segment, width: int, do: Do) -> None:
        self._do, self._waiting = do, bytearray()
        self.path, self.arms, self.rows = path, segment.arms, segment.rows
        self._head = json.dumps({"arms": list(segment.arms), "width": width}).encode() + b"\n"
        self._row = np.empty(width)

    @classmethod
    def kept(cls, path: Path, segment: Segment, width: int, do: Do = at_once) -> RowFile:
        """A file that is there, cut to the rows of ``segment``.

        Raises:
            RowsLost: it is not there, holds something else, or fewer rows.
        """
        self = cls.__new__(cls)
        self._set(path, segment, width, do)
        size = len(self._head) + segment.rows * width * NUMBER
        try:
            with path.open("rb") as file:
                head = file.readline(len(self._head) + 1)
            there = path.stat().st_size
        except OSError as error:
            raise RowsLost(
                f"{path} cannot be read ({error.strerror}): without these rows the run cannot go on"
            ) from None
        if head != self._head or there < size:
            raise RowsLost(
                f"{path}: got {there} bytes that begin with {head[:60]!r}, expected at least {size} that begin with "
                f"{self._head[:60]!r}: without these rows the run cannot go on"
            )
        self._file = path.open("r+b", buffering=0)
        self._file.truncate(size)
        self._file.seek(0, os.SEEK_END)
        return self

    def append(self, parts: list[Array]) -> None:
        np.concatenate(parts, out=self._row)
        self._waiting += self._row.astype("<f8", copy=False).data
        self.rows += 1
        if len(self._waiting) > HANDED_OVER_BYTES:
            self.flush()

    def flush(self) -> None:
        """Have all rows so far written."""
        if self._waiting:
            self._do(partial(_write, self._file, self._waiting))
            self._waiting = bytearray()

    def close(self) -> None:
        """The same, and then let go of the file."""
        self.flush()
        self._do(self._file.close)

    def read(self, most: int) -> Iterator[Array]:
        """All rows, in blocks of at most so many."""
        width = len(self._row)
        with self.path.open("rb") as file:
            file.seek(len(self._head))
            while data := file.read(most * width * NUMBER):
                yield np.frombuffer(data, "<f8").reshape(-1, width)


def _write(file: Any, data: bytearray) -> None:
    """All of it; a system may take a part at a time."""
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]
