"""What a person sees of the chaos bench."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from deploy.chaos.catalogue import Event
from deploy.chaos.outcome import OUTCOMES, Judgement
from deploy.report import VERDICT_STYLE, plain_table


@contextmanager
def runs_bar(console: Console, what: str = "runs") -> Iterator[Callable[[int, int], None]]:
    """A progress bar; gives what is told how many are there, and how many there are to be."""
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=console
    )
    with bar:
        task = bar.add_task(what, total=None)
        yield lambda there, total: bar.update(task, completed=there, total=total)


def print_events(console: Console, events: Sequence[Event]) -> None:
    """A line an event."""
    for event in events:
        rest = {key: value for key, value in event.items() if key not in ("at_s", "kind")}
        words = ", ".join(f"{key} {value}" for key, value in rest.items())
        console.print(f"{event['at_s']:8.3f} s  {event['kind']}: {words}", markup=False, highlight=False)


def print_judgement(console: Console, judgement: Judgement) -> None:
    """The table of the invariants, what became of the load, and the verdict."""
    table = plain_table("invariant", "verdict", "")
    for finding in judgement.findings:
        style = VERDICT_STYLE[finding.verdict]
        table.add_row(finding.invariant, f"[{style}]{finding.verdict}[/]", escape(finding.text))
    console.print(table)
    console.print(f"{judgement.outcome}: {OUTCOMES[judgement.outcome]}", soft_wrap=True, highlight=False)
    console.print(f"verdict: [{VERDICT_STYLE[judgement.verdict]}]{judgement.verdict}[/]")
