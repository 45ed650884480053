"""``palanquin chaos fuzz``."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.exit_status import OF_VERDICT

if TYPE_CHECKING:
    from rich.console import Console

    from deploy.chaos.fuzz.trial import Found

app = typer.Typer()


@app.command()
def fuzz(
    messages: Annotated[int, typer.Option(min=1, help="How many are sent.")] = 1_000_000,
    seed: Annotated[int, typer.Option(min=0, help="Decides all that is drawn.")] = 1,
    arms: Annotated[int, typer.Option(min=1, max=16, help="Arms of the team.")] = 4,
    out: Annotated[
        Path | None, typer.Option(help="Keep the two run folders there; by default they are thrown away.")
    ] = None,
) -> None:
    """Send messages that are not what they should be to everybody who takes messages in.

    The shipped simulator, followers and leader carry in one process, over a link in memory: once undisturbed, and once
    with so many spoiled, misplaced and random messages on all keys. Status 0 if nobody crashed, the trace is the same
    byte for byte and every message was refused and counted; 1 if not.
    """
    from deploy.chaos.bench_commands import new_folder
    from deploy.chaos.fuzz.trial import fuzz as try_it
    from deploy.chaos.printing import runs_bar
    from deploy.report import PatientConsole

    console = PatientConsole()
    with ExitStack() as stack:
        folder = new_folder(out, "fuzz") if out else Path(stack.enter_context(tempfile.TemporaryDirectory()))
        with runs_bar(console, "messages") as told:
            found = try_it(messages, seed, arms, folder, told)
    _print(console, found)
    raise typer.Exit(OF_VERDICT["violated" if found.problems else "holds"])


def _print(console: Console, found: Found) -> None:
    from deploy.chaos.fuzz.trial import AGENTS, SIMULATOR
    from deploy.report import plain_table

    simulator, agents = found.refused[SIMULATOR], found.refused[AGENTS]
    table = plain_table("refused as", SIMULATOR, AGENTS, "together", right=(SIMULATOR, AGENTS, "together"))
    for reason in sorted(simulator.keys() | agents.keys()):
        both = simulator.get(reason, 0), agents.get(reason, 0)
        table.add_row(reason, *(f"{number:,}" for number in (*both, sum(both))))
    sums = sum(simulator.values()), sum(agents.values())
    table.add_row("all", *(f"{number:,}" for number in (*sums, sum(sums))), style="bold")
    console.print(table)
    console.print()
    ways = plain_table("what was wrong", "sent", "whole by chance", right=("sent", "whole by chance"))
    for way, sent in sorted(found.sent.items(), key=lambda each: -each[1]):
        ways.add_row(way, f"{sent:,}", f"{found.left_out[way]:,}" if found.left_out.get(way) else "")
    console.print(ways)
    console.print()
    each_us = 1e6 * (found.fuzzed_s - found.plain_s) / found.messages
    console.print(
        f"{found.messages:,} messages in {found.ticks:,} ticks: {found.plain_s:.1f} s without them, "
        f"{found.fuzzed_s:.1f} s with them ({each_us:.0f} us each, to make it and to refuse it). Those that were whole "
        "by chance were not sent: they are what their receiver is there for.",
        soft_wrap=True,
        highlight=False,
    )
    for problem in found.problems:
        console.print(problem, style="red", markup=False, soft_wrap=True)
    if not found.problems:
        console.print(
            f"nobody crashed, the trace is the same byte for byte (sha256 {found.sha256[:12]}), and all were counted",
            style="green",
            soft_wrap=True,
            highlight=False,
        )
