"""The same run twice, without and with messages that are not what they should be: did they do anything?

Three things are asked: nobody crashed, nothing changed (the trace is the same byte for byte, and so are the events but
for the refusals), and every single message was refused and counted by whoever got it.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.chaos.fuzz.fuzzer import FIRST_TICK, Fuzzer
from deploy.chaos.fuzz.world import Ran, run_in_memory
from sim_server.run_folder import EVENTS, TRACE, read_run
from sim_server.scenario_files import NamedScenario, load_scenario
from wire.keys import Keys
from wire.memory import Broker

AT_ONCE = 20
"""Before each state."""
TICKS_AFTER = 20
"""With which the run goes on when all have been sent."""
SIMULATOR, AGENTS = "simulator", "agents"

Told = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Found:
    """What came of it."""

    sent: Mapping[str, int]
    """By what is wrong with them."""
    left_out: Mapping[str, int]
    """Made, whole by chance, and not sent."""
    refused: Mapping[str, Mapping[str, int]]
    """By side, the simulator's and the agents', and by reason."""
    problems: tuple[str, ...]
    """A sentence for each thing that is not as it should be."""
    ticks: int
    sha256: str
    """Of the trace of the run with them."""
    plain_s: float
    fuzzed_s: float
    """Wall time of the two runs."""

    @property
    def messages(self) -> int:
        return sum(self.sent.values())


def fuzz(messages: int, seed: int, arms: int, folder: Path, told: Told) -> Found:
    """Carry twice, and send so many messages in the second.

    Args:
        folder: where the two run folders go.
        told: is called with how many have been sent, and how many there are to be.
    """
    named = _scenario(messages, arms)
    leader = named.scenario.leader
    assert leader is not None
    every = leader.period_ms // named.scenario.clock.control_period_ms
    made: list[Fuzzer] = []

    def begin(broker: Broker, keys: Keys) -> None:
        names = named.scenario.arms
        made.append(Fuzzer(broker, keys, names, every, seed, messages, AT_ONCE, lambda sent: told(sent, messages)))

    with _quietly():
        began = time.monotonic()
        plain = run_in_memory(named, folder / "plain")
        between = time.monotonic()
        fuzzed = run_in_memory(named, folder / "fuzzed", begin)
        ended = time.monotonic()
    (fuzzer,) = made
    fuzzer.finish()
    problems = [*_crashed("without any", plain), *_crashed("with them", fuzzed)]
    refused: dict[str, Counter[str]] = {SIMULATOR: Counter(), AGENTS: _of_agents(fuzzed)}
    sha256 = ""
    if not (plain.problem or fuzzed.problem):
        problems += _changed(folder / "plain", folder / "fuzzed")
        problems += _not_counted(fuzzer, folder / "fuzzed", fuzzed)
        refused[SIMULATOR] = _by_reason(_of_simulator(folder / "fuzzed"))
        sha256 = _sha256(folder / "fuzzed")
    return Found(
        fuzzer.sent,
        fuzzer.left_out,
        refused,
        tuple(problems),
        named.scenario.ticks,
        sha256,
        between - began,
        ended - between,
    )


def _scenario(messages: int, arms: int) -> NamedScenario:
    """A carry that is just long enough."""
    ticks = FIRST_TICK + math.ceil(messages / (AT_ONCE * arms)) + TICKS_AFTER
    changes = {
        "duration_s": ticks / 1000,
        "team": {"count": arms},
        "record": {"every_ticks": 1, "checkpoint_s": 0.0},
    }
    return load_scenario("transport", changes)


@contextmanager
def _quietly() -> Iterator[None]:
    """Without a line in the log for the first message of each kind."""
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


def _crashed(when: str, ran: Ran) -> Iterator[str]:
    if ran.problem:
        yield f"{when}: the simulator did not come to its end: {ran.problem}"
    for agent in ran.agents:
        if agent.problem:
            yield f"{when}: {agent.name}: {agent.problem}"


def _changed(plain: Path, fuzzed: Path) -> Iterator[str]:
    if _sha256(plain) != _sha256(fuzzed):
        yield "the trace is not that of the run without them"
    if _events(plain) != _events(fuzzed):
        yield "the events are not those of the run without them"
    for name, life in read_run(fuzzed)["agents"].items():
        before = read_run(plain)["agents"][name]
        if any(life[key] != before[key] for key in ("phase", "lease", "missed_ticks")):
            yield f"{name}'s life is not that of the run without them"


def _not_counted(fuzzer: Fuzzer, folder: Path, ran: Ran) -> Iterator[str]:
    if fuzzer.left:
        yield f"{fuzzer.left} messages were not sent before the run's end"
    if fuzzer.not_refused:
        yield f"{fuzzer.not_refused} greetings were not answered with a refusal"
    refused = Counter({f"agent {agent.name}": agent.refused.total() for agent in ran.agents})
    for whose, counts in _of_simulator(folder).items():
        refused[f"simulator, of {whose}"] += sum(counts.values())
    for receiver in sorted(fuzzer.sent_to.keys() | refused.keys()):
        sent, counted = fuzzer.sent_to[receiver], refused[receiver]
        if sent != counted:
            yield f"{receiver}: {sent} messages were sent and {counted} refused"


def _of_simulator(folder: Path) -> dict[str, Counter[str]]:
    """What the simulator has refused, by agent and reason; of those who are nobody here under ``others``."""
    run = read_run(folder)
    found = {name: Counter(agent["refused"]) for name, agent in run["agents"].items()}
    others: Counter[str] = Counter()
    for stranger, times in run["strangers_refused"].items():
        others[stranger.rpartition(" ")[2]] += times
    return {**found, "others": others}


def _of_agents(ran: Ran) -> Counter[str]:
    return _by_reason({agent.name: agent.refused for agent in ran.agents})


def _by_reason(counts: Mapping[str, Counter[str]]) -> Counter[str]:
    return Counter({str(reason): times for reason, times in sum(counts.values(), start=Counter()).items()})


def _sha256(folder: Path) -> str:
    return hashlib.sha256((folder / TRACE).read_bytes()).hexdigest()


def _events(folder: Path) -> list[dict[str, Any]]:
    """All but the refusals."""
    lines = (folder / EVENTS).read_text(encoding="utf-8").splitlines()
    return [event for event in map(json.loads, lines) if event["kind"] != "refused"]
