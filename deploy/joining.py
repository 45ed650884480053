"""``palanquin join``: ask for one more robot, and tell what becomes of it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deploy.exit_status import BAD_INPUT, COULD_NOT_RUN, fail
from deploy.mailbox import post, takes_orders
from sim_server.run_folder import EVENTS
from wire.messages import Order

POLL_S = 0.05
ANSWER_S = 60.0
"""Wall time that the simulator has to say whether somebody comes: it looks once a tick."""


def join_run(folder: Path, strut: int) -> None:
    """Order it and follow the run's events until the newcomer holds its strut, or something is in the way.

    Raises:
        deploy.mailbox.NoSuchRun: no run that goes on.
    """
    events = _from_now_on(folder)
    post(folder, Order("join", strut))
    arm, deadline = "", time.monotonic() + ANSWER_S
    for event in events:
        if event is None:
            if not arm and time.monotonic() > deadline:
                fail(f"{folder}: the simulator has not answered within {ANSWER_S:g} s", COULD_NOT_RUN)
            continue
        kind, at = event["kind"], f"{event['time_s']:.2f} s"
        if kind == "refused_order" and event["strut"] == strut and event.get("agent", "") == arm:
            fail(event["text"], BAD_INPUT)
        elif kind == "wanted" and event["strut"] == strut and not arm:
            arm = event["agent"]
            print(f"{at}: {arm} comes to strut {strut} at {event['at_s']:g} s", flush=True)
        elif event.get("agent") != arm or not arm:
            continue
        elif kind == "seen":
            print(f"{at}: {arm}: {event['effect']}", flush=True)
        elif kind == "grasped":
            most = event["force_max_N"]
            print(f"{at}: {arm} holds strut {strut}; {most:.1f} N at most while it took hold", flush=True)
            return
        elif kind in ("lost", "left"):
            why = event.get("why", kind)
            fail(f"{arm} does not hold strut {strut}: {why}; its log is in {folder / 'logs'}", COULD_NOT_RUN)
    fail(f"{folder}: the run ended before a robot held strut {strut}", COULD_NOT_RUN)


def _from_now_on(folder: Path) -> Iterator[dict[str, Any] | None]:
    """Events that are written from now on, with None after each look, until the run takes no orders any more."""
    path = folder / EVENTS
    read = path.stat().st_size if path.exists() else 0

    def follow() -> Iterator[dict[str, Any] | None]:
        nonlocal read
        going_on = True
        while going_on:
            going_on = takes_orders(folder)
            whole = b""
            if path.exists():
                with path.open("rb") as file:
                    file.seek(read)
                    whole = file.read().rpartition(b"\n")[0]
            if whole:
                read += len(whole) + 1
                yield from map(json.loads, whole.splitlines())
            yield None
            time.sleep(POLL_S)

    return follow()
