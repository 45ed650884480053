"""What a person sees: the progress bar, the table of metrics, the list of scenarios."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table

from deploy.launcher import Show
from deploy.patient_console import PatientConsole as PatientConsole
from sim_server.verdict import Judged
from wire.messages import Progress

NOT_SHOWN = ("verdict", "why_unknown", "tick_parts_us", "tick_late_histogram_us")
"""Too long for a line of the table, or below it."""
VERDICT_STYLE = {"holds": "green", "violated": "bold red", "unknown": "yellow"}


@contextmanager
def progress_display(console: Console, doing: Callable[[], str] = lambda: "carrying") -> Iterator[Show]:
    """A live bar on a terminal, with what is being done; elsewhere a line whenever another tenth of the run is done."""
    if not console.is_terminal:
        yield _plain_lines(console)
        return
    bar = Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[numbers]}"),
        console=console,
        transient=True,
    )
    with bar:
        task = bar.add_task("starting", total=1.0, numbers="")

        def show(progress: Progress) -> None:
            if progress.phase == "waiting":
                bar.update(task, description=f"waiting for {progress.waiting_for}")
                return
            done = progress.tick / progress.ticks
            bar.update(task, description=doing(), completed=done, numbers=_numbers(progress))

        yield show


def _plain_lines(console: Console) -> Show:
    tenth = -1

    def show(progress: Progress) -> None:
        nonlocal tenth
        now = 10 * progress.tick // progress.ticks
        if progress.phase == "running" and now > tenth:
            tenth = now
            console.print(_numbers(progress), highlight=False, soft_wrap=True)

    return show


def _numbers(progress: Progress) -> str:
    total = progress.time_s * progress.ticks / progress.tick if progress.tick else 0.0
    text = f"{progress.time_s:5.1f} of {total:.0f} s, x{progress.real_time_factor:.2f} real time, "
    text += f"tilt {progress.tilt_deg:.2f} deg"
    if progress.goal_distance_m >= 0:
        text += f", {progress.goal_distance_m:.2f} m to the goal"
    if progress.missed_ticks or progress.age_max_ticks:
        text += f", {progress.missed_ticks} ticks missed, oldest command {progress.age_max_ticks}"
    return text


def plain_table(*columns: str, right: Collection[str] = (), show_header: bool = True) -> Table:
    """A table without lines, with these columns; those named in ``right`` keep their figures to the right. The names in
    the first are whole on a narrow terminal too; what stands beside them goes on in further lines."""
    table = Table(box=None, pad_edge=False, header_style="bold", show_header=show_header)
    for column in columns:
        table.add_column(column, justify="right" if column in right else "left", no_wrap=column == columns[0])
    return table


def print_metrics(console: Console, metrics: Mapping[str, Any], judged: Sequence[Judged]) -> None:
    """The table of all metrics, those with a bound first, and the verdict."""
    table = plain_table("metric", "value", "expected", "verdict", right=("value",))
    rows = {row.metric: row for row in judged}
    for name, row in rows.items():
        style = VERDICT_STYLE[row.verdict]
        table.add_row(escape(name), _text(metrics.get(name)), row.expected, f"[{style}]{row.verdict}[/]")
    for name, value in metrics.items():
        if name == "age_ticks":
            table.add_row(escape("commands in time"), _in_time(value), "", "", style="dim")
        elif name not in rows and name not in NOT_SHOWN and value is not None:
            table.add_row(escape(name), _text(value), "", "", style="dim" if isinstance(value, dict) else "")
    console.print(table)
    verdict = metrics["verdict"]
    console.print(f"verdict: [{VERDICT_STYLE[verdict]}]{verdict}[/]")
    for why in metrics.get("why_unknown", ()):
        console.print(f"  {escape(why)}", soft_wrap=True, highlight=False)


def _in_time(ages: Mapping[str, Mapping[str, int]]) -> str:
    """Part of the ticks in which each agent's command answered that very tick."""
    return "  ".join(f"{name} {100.0 * each.get('0', 0) / sum(each.values()):.1f} %" for name, each in ages.items())


def _text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, Mapping):
        return "  ".join(f"{key} {_text(element)}" for key, element in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def print_scenarios(console: Console, lines: Sequence[tuple[str, str]]) -> None:
    """Name and description of every scenario."""
    table = plain_table("name", "description", show_header=False)
    for name, description in lines:
        table.add_row(f"[bold]{name}[/]", description)
    console.print(table)
