"""Wall times of every tick, kept beside the checkpoints: only what is new is written, to the end of a file, so that it
costs no more late in a run than early."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgpack

from sim_server.snapshot import SnapshotError


class WallTimes:
    """A file with the numbers of some growing lists, in ns.

    Args:
        path: of the file.
        lists: by name; whoever measures appends to them.
    """

    def __init__(self, path: Path, lists: Mapping[str, list[int]]) -> None:
        self._path, self._lists = path, lists
        self._written = dict.fromkeys(lists, 0)
        self._size = 0
        self._file: Any = None

    def take_back(self, size: int) -> None:
        """Fill the lists from the first ``size`` bytes of the file; what comes after those is written over.

        Raises:
            SnapshotError: the file is shorter, or holds something else.
            OSError: it cannot be read.
        """
        data = self._path.read_bytes()[:size]
        if len(data) < size:
            raise SnapshotError(f"{self._path.name}: got {len(data)} bytes, expected at least {size}")
        unpacker = msgpack.Unpacker()
        unpacker.feed(data)
        for new in unpacker:
            for name, numbers in new.items():
                self._lists[name].extend(array("q", numbers))
        self._written = {name: len(numbers) for name, numbers in self._lists.items()}
        self._size = size

    def append(self) -> int:
        """Write what is new; the size of the file."""
        if self._file is None:
            self._file = self._path.open("r+b" if self._path.exists() else "xb")
            self._file.truncate(self._size)
            self._file.seek(self._size)
        new = {name: array("q", numbers[self._written[name] :]).tobytes() for name, numbers in self._lists.items()}
        self._size += self._file.write(msgpack.packb(new))
        self._file.flush()
        self._written = {name: len(numbers) for name, numbers in self._lists.items()}
        return self._size

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
