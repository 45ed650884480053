"""The verbs ``palanquin paper`` and ``palanquin verify``."""

from __future__ import annotations

import shlex
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from deploy.exit_status import BAD_INPUT, COULD_NOT_RUN, OF_VERDICT, fail

if TYPE_CHECKING:
    from deploy.paper.judging import Judged
    from deploy.planned_run import Run

TIMES_THREE_SEEDS, ABLATION_SEEDS = 3, 1
"""Most seeds of what stands beside the experiments."""


def paper(
    out: Annotated[Path, typer.Option(help="Where the report goes.")] = Path("runs/paper/report"),
    runs: Annotated[Path, typer.Option(help="Where the runs go; those that are there are not run again.")] = Path(
        "runs/paper"
    ),
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of every condition.")] = 20,
    short: Annotated[bool, typer.Option("--short", help="One seed of each experiment, no ablations: minutes.")] = False,
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only this experiment or ablation; may be repeated.")
    ] = None,
    law: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only runs with this law; may be repeated.")
    ] = None,
    at_once: Annotated[int | None, typer.Option(min=1, help="Runs at a time; one per core by default.")] = None,
    engine: Annotated[Literal["local", "ray"], typer.Option(help="Where runs are run.")] = "local",
    ray_address: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Of the Ray cluster.")] = None,
) -> None:
    """Run every experiment of the paper's section VI, and set its claims beside what was measured."""
    from deploy.batch import engine_of, missing, run_missing
    from deploy.paper.making import make_report
    from deploy.report import PatientConsole

    planned = _planned(seeds, short=short)
    groups = _names(only, "--only", [run.group for run in planned])
    laws = _names(law, "--law", [run.law for run in planned])
    wanted = [run for run in planned if run.group in groups and run.law in laws]
    _check_place(out)
    console = PatientConsole()
    where = engine_of(engine, at_once, ray_address)
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=console
    )
    with bar:
        task = bar.add_task("runs", total=len(wanted))
        problems = run_missing(wanted, runs, where, lambda there, total: bar.update(task, completed=there, total=total))
    for place, problem in problems.items():
        console.print(f"{runs / place}: {problem}", style="red", markup=False, soft_wrap=True)
    left = {run.place for run in missing(wanted, runs)}
    if left:
        console.print(f"{len(left)} runs are not there: start again to go on", style="red")
    command = "palanquin " + shlex.join(sys.argv[1:])
    judged = make_report([run for run in wanted if run.place not in left], runs, out, command)
    _print(console, judged)
    console.print(f"report: {out / 'paper.md'}, {out / 'paper.html'}", soft_wrap=True)
    if left:
        raise typer.Exit(COULD_NOT_RUN)
    claims = [each for each in judged if each.found]
    verdicts = {each.verdict for each in claims if each.preset == "paper"} or {each.verdict for each in claims}
    raise typer.Exit(
        OF_VERDICT["violated" if "violated" in verdicts else "unknown" if "unknown" in verdicts else "holds"]
    )


def _check_place(out: Path) -> None:
    """Before an hour of runs: whether the report can be written there. Ends the verb with one sentence if not."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        fail(f"--out {out}: no report can be written there ({error.strerror}); expected a folder", BAD_INPUT)


def _planned(seeds: int, *, short: bool) -> list[Run]:
    from deploy.paper.ablations import ablation_runs, alone_runs, times_three_runs
    from deploy.paper.plan import section_vi_runs

    if short:
        first = range(1, 2)
        return [*section_vi_runs(first), *alone_runs(first)]
    return [
        *section_vi_runs(range(1, 1 + seeds)),
        *times_three_runs(range(1, 1 + min(seeds, TIMES_THREE_SEEDS))),
        *ablation_runs(range(1, 1 + min(seeds, ABLATION_SEEDS))),
    ]


def _names(asked: list[str] | None, option: str, known: Sequence[str]) -> set[str]:
    """What was asked for; all without an answer. Raises ``typer.BadParameter`` for a name of nothing."""
    for name in asked or []:
        if name not in known:
            raise typer.BadParameter(f"{option} {name}: expected one of {', '.join(dict.fromkeys(known))}")
    return set(asked or known)


def _print(console: Console, judged: Sequence[Judged]) -> None:
    """The claims that there are runs for."""
    from deploy.report import VERDICT_STYLE, plain_table

    table = plain_table("claim", "law", "measured", "bound", "seeds", "verdict")
    for each in judged:
        if each.found:
            spread = each.spread
            text = f"{spread.text()} {each.found[0].unit}" if spread else ""
            style = VERDICT_STYLE[each.verdict]
            table.add_row(
                each.claim.name, each.preset, text, each.found[0].bound, f"{each.holds_in} of {len(each.found)}",
                f"[{style}]{each.verdict}[/]",
            )  # fmt: skip
    console.print(table)


def verify(
    report: Annotated[Path, typer.Argument(metavar="REPORT", help="A report.json, or the folder that it is in.")],
    count: Annotated[int, typer.Option("--sample", min=1, help="How many runs to run again.")] = 3,
    claims: Annotated[
        int, typer.Option("--claims", min=0, help="How many claims to judge again, each in one seed, from new runs.")
    ] = 2,
    seed: Annotated[int, typer.Option(help="Which ones: another seed draws others.")] = 1,
) -> None:
    """Run a sample of a report's runs again, judge a sample of its claims again, and compare."""
    from deploy.paper.judging_again import MadeAgain, drawn, judged_again, unfounded
    from deploy.paper.verifying import differences, read_report, run_again, sample, spoiled
    from sim_server.run_description import versions

    content = read_report(report)
    ours = {name: version for name, version in versions().items() if name != "commit"}
    exact = all(content["versions"].get(name) == version for name, version in ours.items())
    console, wrong = Console(), 0
    console.print("same versions: every bit has to be the same" if exact else "other versions: one part in a thousand")
    for name in spoiled(content) if exact else ():
        wrong += 1
        console.print(f"{name}: DIFFERS: its digests are not those of what it says of itself", markup=False)
    for name in unfounded(content):
        wrong += 1
        console.print(f"{name}: DIFFERS: its verdict does not follow from its values", markup=False)
    for entry in sample(content, count, seed):
        with tempfile.TemporaryDirectory() as folder:
            found = differences(entry, run_again(entry, Path(folder) / "run"), exact=exact)
        wrong += len(found)
        console.print(f"{entry['name']}: {'as reported' if not found else 'DIFFERS'}", markup=False)
        for each in found:
            console.print(f"  {each.metric}: reported {each.reported}, found {each.found}", markup=False)
    with tempfile.TemporaryDirectory() as folder:
        runs = MadeAgain(content, Path(folder))
        for one in drawn(content, claims, seed):
            same, value = judged_again(one, runs, exact=exact)
            wrong += not same
            text = "as reported" if same else f"DIFFERS: reported {one.reported}, found {value}"
            console.print(f"claim {one.name}: {text}", markup=False)
    raise typer.Exit(1 if wrong else 0)
