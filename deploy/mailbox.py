"""Orders to a run that goes on: small files in its folder, which its launcher hands on to the simulator.

Whoever may write the run's folder may order; a follower inside its walls may not even read it. A launcher that lives
holds a lock on the place, so that one that was killed is not waited for.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
from contextlib import suppress
from pathlib import Path

from sim_server.errors import SimError
from wire.codec import decode, encode
from wire.errors import Refused
from wire.messages import Order

ORDERS = "orders"
SUFFIX = ".order"


class NoSuchRun(SimError):
    """No run that takes orders."""


class Mailbox:
    """The launcher's side. Exists as long as the run does."""

    def __init__(self, folder: Path) -> None:
        self._place = folder / ORDERS
        self._place.mkdir(mode=0o700, exist_ok=True)
        self._lock = os.open(self._place, os.O_RDONLY)
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def take(self) -> list[Order]:
        """What has come since the last look; a file that is no order is thrown away."""
        found = []
        for file in sorted(self._place.glob(f"*{SUFFIX}")):
            with suppress(OSError, Refused):
                found.append(decode(file.read_bytes(), Order))
            file.unlink(missing_ok=True)
        return found

    def close(self) -> None:
        """No orders any more."""
        os.close(self._lock)
        shutil.rmtree(self._place, ignore_errors=True)


def takes_orders(folder: Path) -> bool:
    """Whether a launcher lives that looks into this folder's mailbox."""
    try:
        place = os.open(folder / ORDERS, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return False
    try:
        fcntl.flock(place, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(place)
    return False


def post(folder: Path, order: Order) -> None:
    """Give an order to the run in this folder.

    Raises:
        NoSuchRun: there is none, or it has ended.
    """
    if not takes_orders(folder):
        raise NoSuchRun(
            f"{folder}: no run that takes orders; expected the folder of a run that `palanquin run` started and that "
            "goes on"
        )
    name = folder / ORDERS / secrets.token_hex(8)
    try:
        name.write_bytes(encode(order))
        name.replace(name.with_suffix(SUFFIX))
    except OSError as error:
        raise NoSuchRun(f"{name.parent}: cannot be written ({error.strerror}); the run may have just ended") from None
