"""What a bench prints: a table for each part, and one that sets two files side by side."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from deploy.bench.comparison import Compared
from deploy.bench.figures import RATIO, Figure, Part
from deploy.bench.machine import machine_text
from deploy.report import PatientConsole, plain_table

WIDTH = 150
STYLE = {"better": "green", "worse": "bold red", "same": "", None: "dim"}


def bench_console() -> Console:
    """A console whose tables are whole in a file or a pipe too."""
    console = PatientConsole()
    if not console.is_terminal:
        console.width = max(console.width, WIDTH)
    return console


def print_machine(console: Console, machine: dict[str, Any]) -> None:
    """The line above all tables."""
    console.print(machine_text(machine), soft_wrap=True, highlight=False, markup=False)


def print_part(console: Console, part: Part) -> None:
    """Rows and columns of a part: the median, and with several turns the least and the greatest below."""
    columns = list(dict.fromkeys(figure.column for figure in part.figures))
    rows = list(dict.fromkeys((figure.row, figure.unit) for figure in part.figures))
    found = {(figure.row, figure.unit, figure.column): figure for figure in part.figures}
    console.print(f"\n[bold]{part.title}[/] ({part.name}, {part.wall_s:.0f} s)", highlight=False)
    table = plain_table("", "unit", *columns, right=columns)
    for row, unit in rows:
        cells = [found.get((row, unit, column)) for column in columns]
        style = "bold" if unit == RATIO else ""
        table.add_row(row, unit, *("" if cell is None else text_of(cell) for cell in cells), style=style)
    console.print(table, highlight=False, markup=False)
    for sentence in part.said:
        console.print(sentence, soft_wrap=True, highlight=False, markup=False, style="dim")


def text_of(figure: Figure) -> str:
    """The median, with the range of the turns where there are several."""
    if len(figure.values) == 1:
        return short(figure.value)
    return f"{short(figure.value)} ({short(figure.low)} to {short(figure.high)})"


def short(value: float) -> str:
    """Three digits that count, without an exponent."""
    if value == 0.0:
        return "0"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def print_comparison(console: Console, rows: list[Compared], old: dict[str, Any], new: dict[str, Any]) -> None:
    """The figures that both files have."""
    for name, machine in (("old", old), ("new", new)):
        console.print(f"{name}: {machine_text(machine)}", soft_wrap=True, highlight=False, markup=False)
    for part in dict.fromkeys(row.part for row in rows):
        table = plain_table(part, "", "unit", "old", "new", "new/old", "", right=("old", "new", "new/old"))
        for row in (each for each in rows if each.part == part):
            change = "" if row.change is None else f"{row.change:.2f}"
            cells = [row.old.unit, short(row.old.value), short(row.new.value), change, row.judged or ""]
            table.add_row(row.old.row, row.old.column, *cells, style=STYLE[row.judged])
        console.print()
        console.print(table, highlight=False, markup=False)
    console.print(
        f"Only ratios ({RATIO}) can be compared between two runs: times move with the machine. Better or worse: the "
        "ranges of the turns do not meet.",
        soft_wrap=True,
        style="dim",
    )
