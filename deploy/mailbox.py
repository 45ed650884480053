"""Orders to a run that goes on: small files in its folder, which its launcher hands on to the simulator.

Whoever may write the run's folder may order; a follower inside its walls may not even read it.
"""

from __future__ import annotations

import json
import secrets
from pathlib import Path

from sim_server.errors import SimError
from wire.messages import Order

ORDERS = "orders"
SUFFIX = ".json"


class NoSuchRun(SimError):
    """No run that takes orders."""


class Mailbox:
    """The launcher's side. Exists as long as the run does."""

    def __init__(self, folder: Path) -> None:
        self._place = folder / ORDERS
        self._place.mkdir(mode=0o700, exist_ok=True)

    def take(self) -> list[Order]:
        """What has come since the last look; a file that is no order is thrown away."""
        found = []
        for file in sorted(self._place.glob(f"*{SUFFIX}")):
            try:
                asked = json.loads(file.read_text(encoding="utf-8"))
                found.append(Order(asked["verb"], int(asked["strut"])))
            except (ValueError, LookupError, TypeError, OSError):
                pass
            file.unlink(missing_ok=True)
        return found

    def close(self) -> None:
        """No orders any more."""
        for file in self._place.glob("*"):
            file.unlink(missing_ok=True)
        self._place.rmdir()


def post(folder: Path, order: Order) -> None:
    """Give an order to the run in this folder.

    Raises:
        NoSuchRun: there is none, or it has ended.
    """
    place = folder / ORDERS
    if not place.is_dir():
        raise NoSuchRun(
            f"{folder}: no run that takes orders; expected the folder of one that `palanquin run` started and that "
            "goes on"
        )
    new = place / f".{secrets.token_hex(8)}"
    try:
        new.write_text(json.dumps({"verb": order.verb, "strut": order.strut}), encoding="utf-8")
        new.replace(place / f"{secrets.token_hex(8)}{SUFFIX}")
    except OSError as error:
        raise NoSuchRun(f"{place}: cannot be written ({error.strerror}); the run may have just ended") from None
