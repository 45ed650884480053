"""From the launcher, which has the person's device, to the leader's process: over its standard input."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import IO


class Wishes:
    """The newest wish, and who is told it: the newest leader, be it the first one or one that was started again."""

    def __init__(self) -> None:
        self._newest = b""
        self._to: IO[bytes] | None = None
        self._one_at_a_time = threading.Lock()

    def tell(self, line: bytes) -> None:
        """A new wish; from any thread."""
        with self._one_at_a_time:
            self._newest = line
            self._write()

    def listener(self, to: IO[bytes] | None) -> None:
        """Somebody who has its credential, and reads wishes from now on."""
        with self._one_at_a_time:
            self._to = to
            self._write()

    def _write(self) -> None:
        if self._to is not None and self._newest:
            with suppress(OSError, ValueError):  # it has ended
                self._to.write(self._newest)
                self._to.flush()
