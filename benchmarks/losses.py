"""What losses cost: ``python benchmarks/losses.py [detection|rounds|repeats [N]]``. Prints, asserts nothing.

``detection``: how soon the loss of one of two followers is noticed, N times each (3), in ticks and in wall time, for
every way in which it can be lost; nothing is scheduled, the simulator is told nothing. ``rounds``: one agent killed and
started N times (50) in one run, and what the simulator holds in memory, descriptors and threads meanwhile, beside a run
in which it is only stopped for 10 ms. ``repeats``: ``dropout``, ``rejoin``, ``join`` and ``relay`` N times (3), and
their traces' sums. Without an argument all of it, about half an hour on two cores.
"""

from __future__ import annotations

import hashlib
import json
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from rich.console import Console
from rich.table import Table

from deploy.relay import Relay
from wire.endpoints import parse_endpoint
from wire.zenoh_link import free_endpoint

PALANQUIN = Path(sys.executable).with_name("palanquin")
PATIENCE_S = 120.0
SETTLED_S = 1.0
"""Wall time of carrying before the fault."""
SHOWN_ROUNDS = (1, 10, 20, 30, 40, 50)
BEFORE_ROUNDS_S = 1.25
"""Simulated time before the first round: by then a whole block of the trace has been filled and written for the first
time, which takes 25 MB for good."""
EVERY_TICK = "[record]\nevery_ticks = 1\n"

LIGHT = """
extends = "transport"
description = "Two arms and a light table, of which one will be lost."
duration_s = {duration_s}
[team]
count = 2
[load]
mass_kg = 8.0
"""
CLOCKS = {
    "lock-step, 1 ms": "",
    "real time, 4 ms": '[clock]\nmode = "real-time"\ncontrol_period_ms = 4\n[leader]\nperiod_ms = 12\n',
}
CONTROLLERS = """
import time
from agents.controllers.paper import PaperController

class Later(PaperController):
    def __init__(self, arm):
        super().__init__(arm)
        self.lived_s = 0.0

    def step(self, sensed, dt_s):
        self.lived_s += dt_s
        if self.lived_s >= 1.0:
            self.then()
        return super().step(sensed, dt_s)

class Hung(Later):
    def then(self):
        print(f"fault at {time.time()!r}", flush=True)
        while True:
            pass

class Slow30(Later):
    def then(self):
        time.sleep(0.030)

class Slow100(Later):
    def then(self):
        if self.lived_s < 1.004:
            print(f"fault at {time.time()!r}", flush=True)
        time.sleep(0.100)
"""


@dataclass(frozen=True, slots=True)
class Victim:
    """Arm a2's process, and the relay in its connection."""

    process: subprocess.Popen[bytes]
    relay: Relay


@dataclass(frozen=True, slots=True)
class Fault:
    """One way to lose a follower: by what is done to it, or by its own controller."""

    name: str
    act: Callable[[Victim], object] | None = None
    controller: str = "paper"
    patience_s: float = 30.0
    """Wall time in which it is lost, if it is."""


FAULTS = (
    Fault("process killed (SIGKILL)", lambda victim: victim.process.kill()),
    Fault("process stopped (SIGSTOP)", lambda victim: victim.process.send_signal(signal.SIGSTOP)),
    Fault("control loop hangs", controller="faulty:Hung"),
    Fault("link closed", lambda victim: victim.relay.cut()),
    Fault("link silent", lambda victim: victim.relay.silence()),
    Fault("100 ms per tick", controller="faulty:Slow100", patience_s=6.0),
    Fault("30 ms per tick", controller="faulty:Slow30", patience_s=6.0),
)


@dataclass(frozen=True, slots=True)
class Seen:
    """What came of a fault."""

    lost: dict[str, Any] | None
    """The event; None if it was not lost."""
    wall_ms: float
    oldest: float | None
    """Oldest command obeyed, in ticks; real time only."""
    missed_in_row: float


def read_events(folder: Path) -> list[dict[str, Any]]:
    """Whole lines of a run's events so far."""
    path = folder / "events.jsonl"
    whole = path.read_text().rpartition("\n")[0] if path.exists() else ""
    return [json.loads(line) for line in whole.splitlines()]


def await_event(
    folder: Path, sim: subprocess.Popen[bytes], kind: str, count: int = 1, patience_s: float = PATIENCE_S
) -> list[dict[str, Any]]:
    """Events of this kind as soon as there are so many, or the simulator has ended, or patience."""
    deadline = time.monotonic() + patience_s
    while True:
        ended = sim.poll() is not None or time.monotonic() > deadline
        found = [event for event in read_events(folder) if event["kind"] == kind]
        if len(found) >= count or ended:
            return found
        time.sleep(0.001)


@contextmanager
def process(cwd: Path, name: str, *arguments: str | Path) -> Iterator[subprocess.Popen[bytes]]:
    """A ``palanquin`` command that does not outlive the block; what it says is in ``cwd/name.log``."""
    with (cwd / f"{name}.log").open("wb") as log:
        child = subprocess.Popen([PALANQUIN, *arguments], cwd=cwd, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
    try:
        yield child
    finally:
        child.kill()
        child.wait()


def lose_one(cwd: Path, fault: Fault, clock: str) -> Seen:
    """Two arms carry, and then this happens to one of them."""
    (cwd / "light.toml").write_text(LIGHT.format(duration_s=60.0) + CLOCKS[clock])
    (cwd / "faulty.py").write_text(CONTROLLERS)
    endpoint, folder = free_endpoint(), cwd / "run"
    with ExitStack() as stack:

        def start(name: str, *arguments: str | Path) -> subprocess.Popen[bytes]:
            return stack.enter_context(process(cwd, name, *arguments, "--run", "loss"))

        sim = start("sim", "sim", "light.toml", "--open", "--listen", endpoint, "--out", folder)
        while sim.poll() is None and not parse_endpoint(endpoint).somebody_listens():
            time.sleep(0.05)
        relay = Relay(endpoint)
        stack.callback(relay.close)
        start("a1", "follower", "--arm", "a1", "--connect", endpoint)
        start("leader", "leader", "--goal-m", "2", "0", "--connect", endpoint)
        victim = start("a2", "follower", "--arm", "a2", "--connect", relay.endpoint, "--controller", fault.controller)
        await_event(folder, sim, "started")
        fault_at = 0.0
        if fault.act is not None:
            time.sleep(SETTLED_S)
            fault_at = time.time()
            fault.act(Victim(victim, relay))
        lost = await_event(folder, sim, "lost", patience_s=fault.patience_s)
        seen_at = time.time()
        sim.send_signal(signal.SIGINT)
        sim.wait(PATIENCE_S)
        metrics = json.loads((folder / "metrics.json").read_text())
    if fault.act is None and lost:
        said = (cwd / "a2.log").read_text()
        fault_at = float(said.partition("fault at ")[2].split()[0])
    return Seen(
        lost[0] if lost else None,
        1e3 * (seen_at - fault_at) if lost else float("nan"),
        metrics["age_max_ticks"],
        metrics["missed_in_row_max"],
    )


def spread(values: Sequence[float]) -> str:
    """The median, and the range if there is one."""
    low, high = min(values), max(values)
    middle = f"{statistics.median(values):.0f}"
    return middle if f"{low:.0f}" == f"{high:.0f}" else f"{middle} ({low:.0f} to {high:.0f})"


def detection(console: Console, repeats: int) -> None:
    """How soon a loss is noticed."""
    columns = ("fault", "clock", "missed ticks", "wall ms until lost", "why", "the arm then")
    table = Table(*columns, title=f"a follower lost, {repeats} times each")
    for fault in FAULTS:
        for clock in CLOCKS:
            found = []
            for _ in range(repeats):
                with tempfile.TemporaryDirectory(prefix="palanquin-") as cwd:
                    found.append(lose_one(Path(cwd), fault, clock))
                print(f"{fault.name}, {clock}: {found[-1]}", file=sys.stderr)
            lost = [seen.lost for seen in found if seen.lost is not None]
            if len(lost) < repeats:
                ages = [seen.oldest for seen in found if seen.oldest is not None]
                then = f"obeys, commands up to {spread(ages)} ticks old" if ages else "is waited for"
                missed = spread([seen.missed_in_row for seen in found])
                table.add_row(fault.name, clock, missed, f"not lost ({repeats - len(lost)} of {repeats})", "", then)
                continue
            why = " | ".join(sorted({each["why"] for each in lost}))
            missed = spread([each["missed_ticks"] for each in lost])
            table.add_row(fault.name, clock, missed, spread([s.wall_ms for s in found]), why, lost[0]["then"])
    console.print(table)


def child_named(root: psutil.Process, verb: str) -> psutil.Process:
    """The child of ``palanquin run`` that runs this verb."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        for each in root.children():
            with suppress(psutil.NoSuchProcess):
                if verb in each.cmdline():
                    return each
        time.sleep(0.01)
    raise TimeoutError(f"palanquin run has started no {verb}")


@dataclass(frozen=True, slots=True)
class Held:
    """What a process holds."""

    resident_MB: float
    descriptors: int
    threads: int

    @classmethod
    def by(cls, process: psutil.Process) -> Held:
        return cls(process.memory_info().rss / 1e6, process.num_fds(), process.num_threads())


def held_over_rounds(
    cwd: Path, kinds: tuple[str, str], apart_s: float, rounds: int
) -> tuple[dict[int, Held], list[str]]:
    """What the simulator holds after each round of two events, one round per 0.1 s, and who is left at the end."""
    events = "".join(
        f'[[events]]\nat_s = {BEFORE_ROUNDS_S + 0.1 * k + apart_s * half:.2f}\nkind = "{kind}"\nagent = "a2"\n'
        for k in range(rounds)
        for half, kind in enumerate(kinds)
    )
    (cwd / "rounds.toml").write_text(
        LIGHT.format(duration_s=BEFORE_ROUNDS_S + 0.1 * rounds + 1.0) + EVERY_TICK + events
    )
    folder, held, family = cwd / "run", dict[int, Held](), dict[int, psutil.Process]()
    with process(cwd, "run", "run", "rounds.toml", "--out", folder) as command:
        root = psutil.Process(command.pid)
        sim = child_named(root, "sim")
        for k in range(1, rounds + 1):
            seen = await_event(folder, command, "seen", 2 * k)
            if len(seen) < 2 * k:
                break
            held[k] = Held.by(sim)
            with suppress(psutil.NoSuchProcess):
                family |= {each.pid: each for each in root.children(recursive=True)}
        command.wait(PATIENCE_S)
    return held, [str(each) for each in family.values() if each.is_running()]


def rounds(console: Console, count: int) -> None:
    """Kill and start over and over, beside a run of the same length in which nobody goes."""
    columns = ("round", "resident MB", "descriptors", "threads", "nobody goes: MB", "descriptors", "threads")
    table = Table(*columns, title=f"the simulator over {count} rounds of kill and start")
    with tempfile.TemporaryDirectory(prefix="palanquin-") as cwd:
        held, left = held_over_rounds(Path(cwd), ("kill", "start"), 0.05, count)
    with tempfile.TemporaryDirectory(prefix="palanquin-") as cwd:
        control, _ = held_over_rounds(Path(cwd), ("stop", "continue"), 0.01, count)
    for k in sorted({*SHOWN_ROUNDS, count} & held.keys()):
        row = [f"{held[k].resident_MB:.2f}", str(held[k].descriptors), str(held[k].threads)]
        beside = control.get(k)
        if beside is not None:
            row += [f"{beside.resident_MB:.2f}", str(beside.descriptors), str(beside.threads)]
        table.add_row(str(k), *row)
    console.print(table)
    console.print(f"rounds done: {len(held)} of {count}; processes left over: {len(left)}", *left)


def repeats(console: Console, times: int) -> None:
    """The same scenario over and over: the same bytes?"""
    table = Table("scenario", "run", "status", "wall s", "sha256 of trace.parquet", title="real kills, the same bytes")
    for scenario in ("dropout", "rejoin", "join", "relay"):
        for k in range(1, times + 1):
            with tempfile.TemporaryDirectory(prefix="palanquin-") as cwd:
                start = time.monotonic()
                ended = subprocess.run(
                    [PALANQUIN, "run", scenario, "--out", "run"], cwd=cwd, stdout=subprocess.DEVNULL, check=False
                )
                digest = hashlib.sha256((Path(cwd) / "run" / "trace.parquet").read_bytes()).hexdigest()
            wall_s = f"{time.monotonic() - start:.0f}"
            table.add_row(scenario, str(k), str(ended.returncode), wall_s, digest)
            print(f"{scenario} {k}: {wall_s} s, {digest}", file=sys.stderr)
    console.print(table)


PARTS: dict[str, tuple[Callable[[Console, int], None], int]] = {
    "detection": (detection, 3),
    "rounds": (rounds, 50),
    "repeats": (repeats, 3),
}


def main() -> None:
    console = Console(width=160)
    wanted = sys.argv[1:2] or list(PARTS)
    for name in wanted:
        part, times = PARTS[name]
        part(console, int(sys.argv[2]) if len(sys.argv) > 2 else times)


if __name__ == "__main__":
    main()
