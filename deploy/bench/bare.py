"""The processes of a bare transport: ``python -m deploy.bench.bare hub|agent ...``, started by deploy/bench/rigs.py.

A hub sends every agent a message and waits for all answers, tick after tick, as the simulator does; nothing is
computed.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict

from deploy.bench.transports import AGENTS, HUBS, Talk


def run_hub(transport: str, place: str, talks: Sequence[Talk]) -> None:
    """Say ``listening``, then ``ready``; then, for every line with a number of seconds, tick so long and say the ticks
    and the wall time. Ends with its standard input."""
    hub = HUBS[transport](place, talks)
    print("listening", flush=True)
    hub.wait_for_agents()
    print("ready", flush=True)
    always = [number for number, talk in enumerate(talks) if talk.every == 1]
    everybody = list(range(len(talks)))
    every = max(talk.every for talk in talks)
    tick = 0
    while line := _line_of_input():
        start = now = time.perf_counter()
        end, first = start + float(line), tick
        while now < end:
            due = always if tick % every else everybody
            for number in due:
                hub.send(number)
            hub.receive(due)
            tick += 1
            now = time.perf_counter()
        print(json.dumps({"ticks": tick - first, "wall_s": now - start}), flush=True)
    os._exit(0)  # no transport may hold it back


def as_words(talk: Talk) -> str:
    """A talk as one argument."""
    return json.dumps(asdict(talk))


def _line_of_input() -> str:
    """Byte by byte: a credential may have been read before, from the same descriptor."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        if not byte:
            return ""
        line += byte
    return line.decode()


def main() -> None:
    """One process of a rig."""
    role, transport, place, *words = sys.argv[1:]
    talks = [Talk(**json.loads(word)) for word in words]
    if role == "hub":
        run_hub(transport, place, talks)
        return
    from deploy.guard import end_with_parent

    if transport != "zenoh":  # that one watches its standard input itself
        end_with_parent(lambda: os._exit(0), even_if_stopped=True)
    AGENTS[transport](place, talks[0])


if __name__ == "__main__":
    main()
