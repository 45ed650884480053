"""The verb ``palanquin bench``."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.exit_status import BAD_INPUT, fail

if TYPE_CHECKING:
    from deploy.bench.plan import Plan

MOST_ARMS = 16


def bench(
    parts: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PART]...",
            help="controller, physics, lock-step, growth, real-time, start-up, memory, watching; all by default.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write all figures there, as JSON.")] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Everything once and briefly: whether it works, not how fast it is.")
    ] = False,
    arms: Annotated[
        list[int] | None,
        typer.Option(
            min=1,
            max=MOST_ARMS,
            help="A size of team of physics, lock-step and growth; may be repeated; 1, 2, 4, 8, 16.",
        ),
    ] = None,
    rate: Annotated[
        list[int] | None,
        typer.Option(metavar="HZ", help="Of real time: 250, 500 or 1000; may be repeated; all by default."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, max=300.0, help="Wall time of each carry, from its first tick; 4.")
    ] = None,
    turns: Annotated[int | None, typer.Option(min=1, max=1000, help="How often everything is measured; 3.")] = None,
    compare: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="OLD NEW", help="Set two such files side by side, and measure nothing."),
    ] = None,
) -> None:
    """Measure what the system costs, each figure beside what it is built on, in turns.

    Times move with the machine by a factor of two; ratios of one turn hardly do, and are what two files can be compared
    by.
    """
    if compare is not None:
        _compare(*compare)
        return
    from deploy.bench.parts import PARTS
    from deploy.bench.plan import QUICK, Plan

    for name in parts or []:
        if name not in PARTS:
            raise typer.BadParameter(f"{name}: expected one of {', '.join(PARTS)}")
    plan = QUICK if quick else Plan()
    for hz in rate or []:
        if hz not in Plan().rates_hz:
            raise typer.BadParameter(f"--rate {hz}: expected one of {', '.join(map(str, Plan().rates_hz))}")
    if arms:
        plan = replace(plan, arms=tuple(sorted(set(arms))))
    if rate:
        plan = replace(plan, rates_hz=tuple(sorted(set(rate))))
    if seconds is not None:
        plan = replace(plan, seconds=seconds)
    if turns is not None:
        plan = replace(plan, turns=turns)
    if out is not None:
        _check_place(out)
    wanted = [name for name in PARTS if not parts or name in parts]
    _measure(wanted, plan, out)


def _measure(wanted: list[str], plan: Plan, out: Path | None) -> None:
    """Print each part when it is done, and write the file anew with it: what was measured is not lost by what fails."""
    from deploy.bench.figures import Part, as_file
    from deploy.bench.machine import describe_machine
    from deploy.bench.parts import run_parts
    from deploy.bench.tables import bench_console, print_machine, print_part
    from sim_server.run_folder import write_json

    console, machine, done = bench_console(), describe_machine(), list[Part]()
    print_machine(console, machine)
    with console.status("measuring") as status:
        for part in run_parts(wanted, plan, status.update):
            done.append(part)
            print_part(console, part)
            if out is not None:
                write_json(out, as_file(machine, plan.as_fields(), done))
    if out is not None:
        console.print(f"\nfigures: {out}", soft_wrap=True, markup=False, highlight=False)


def _compare(old: Path, new: Path) -> None:
    from deploy.bench.comparison import compared
    from deploy.bench.figures import read_file
    from deploy.bench.tables import bench_console, print_comparison

    (old_machine, before), (new_machine, after) = read_file(old), read_file(new)
    print_comparison(bench_console(), compared(before, after), old_machine, new_machine)


def _check_place(out: Path) -> None:
    """Before minutes of measuring: whether the file can be written there. Ends the verb with one sentence if not."""
    if out.is_dir():
        fail(f"--out {out}: a folder, expected the name of a file", BAD_INPUT)
    try:
        with tempfile.TemporaryFile(dir=out.absolute().parent):
            pass
    except OSError as error:
        fail(f"--out {out}: no file can be written there ({error.strerror})", BAD_INPUT)
