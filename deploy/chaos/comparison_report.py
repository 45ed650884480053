"""What ``palanquin chaos intruder`` prints and leaves: a row an attempt, on the open system and here."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from deploy.chaos.comparison import Comparison
from deploy.chaos.intruder import Row
from deploy.exit_status import COULD_NOT_RUN, OF_VERDICT
from deploy.report import plain_table
from sim_server.run_folder import write_json

REPORT = "report.json"
TABLE = "report.md"


def status(comparison: Comparison) -> int:
    """0: all closed; 3: the intruder's own session failed in some attempt, so nobody knows; 1: something is open."""
    disturbed = comparison.same_trace is False or "violated" in comparison.expect or comparison.audit == "violated"
    if disturbed or any(row.got.tested and row.got.is_open is not False for row in comparison.here):
        return OF_VERDICT["violated"]
    return COULD_NOT_RUN if _untested(comparison) else OF_VERDICT["holds"]


def is_closed(comparison: Comparison) -> bool:
    """Whether every attempt was made, was closed here, and changed nothing."""
    return status(comparison) == OF_VERDICT["holds"]


def _untested(comparison: Comparison) -> list[str]:
    """Names of the attempts that were not made, on either system."""
    names = (row.name for row in (*comparison.here, *comparison.open) if not row.got.tested)
    return list(dict.fromkeys(names))


def print_and_write(console: Console, comparison: Comparison, folder: Path) -> None:
    """The table on the screen; ``report.json`` and ``report.md`` in the folder."""
    opened = {row.name: row for row in comparison.open}
    rows = [(row.name, _said(opened.get(row.name)), _said(row)) for row in comparison.here]
    columns = ("what was tried", "open system (measured)", f"here, {comparison.protection} (measured)")
    table = plain_table(*columns)
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)
    summary = _summary(comparison)
    for line in summary:
        console.print(line, soft_wrap=True, highlight=False)
    console.print(f"report: {folder / TABLE}", soft_wrap=True, highlight=False)
    content = {**asdict(comparison), "closed": is_closed(comparison), "summary": summary}
    write_json(folder / REPORT, content)
    lines = ["| " + " | ".join(columns) + " |", "|---|---|---|"]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    text = "\n".join(["# The intruder", "", *(f"- {line}" for line in summary), "", *lines])
    (folder / TABLE).write_text(text + "\n", encoding="utf-8")


def _said(row: Row | None) -> str:
    if row is None:
        return "not run"
    if not row.got.tested:
        return f"not tested: {row.got.evidence}"
    opened = "OPEN (heard, no effect)" if row.got.only_heard else "OPEN"
    return f"{opened if row.got.is_open else 'closed'}: {row.got.evidence}"


def _summary(comparison: Comparison) -> list[str]:
    closed = sum(row.got.is_open is False for row in comparison.here)
    lines = [
        f"{closed} of {len(comparison.here)} attempts closed here ({comparison.arms} arms, {comparison.ticks} ticks)"
    ]
    if untested := _untested(comparison):
        lines.append(f"not tested, the intruder's own session did not work: {', '.join(untested)}")
    if comparison.open:
        opened = sum(row.got.is_open is True for row in comparison.open)
        effect = sum(row.got.is_open is True and not row.got.only_heard for row in comparison.open)
        lines.append(
            f"{opened} of {len(comparison.open)} were open on an open system: {effect} gave the intruder something,"
            f" {opened - effect} were only heard on another's key and refused there"
        )
    same = {True: "the same, byte for byte", False: "NOT the same", None: "not compared"}[comparison.same_trace]
    lines.append(f"the trace and that of the run without an intruder: {same}")
    if comparison.expect:
        lines.append(f"the attacked run's bounds that hold at any time: {comparison.expect}")
    lines.append(f"the audit of the attacked run (no key reached two agents): {comparison.audit}")
    return lines
