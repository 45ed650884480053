"""What ``palanquin audit`` prints: who took part, what crossed the simulator's edge, who heard what, the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from deploy.report import VERDICT_STYLE, plain_table
from deploy.walls import walls_in_log
from sim_server.run_folder import LOGS

RIGHT = ("messages", "bytes", "lease", "bytes to it", "explained", "bytes from it")
WAYS = {"to": "sim -> agent", "from": "agent -> sim"}


def print_audit(console: Console, audit: Mapping[str, Any], folder: Path) -> None:
    """Three tables and the verdict with its reasons."""
    processes = plain_table("agent", "process", "host", "lease", right=RIGHT)
    walls: dict[str, list[str]] = {}
    for name, process in audit["processes"].items():
        processes.add_row(name, *(_shown(process.get(what)) for what in ("pid", "host", "lease")))
        walls.setdefault(walls_in_log(folder / LOGS / f"{name}.log") or "not told", []).append(name)
    console.print(processes, "")
    for told, names in walls.items():
        console.print(f"walls around {', '.join(names)}, as they say: {escape(told)}", soft_wrap=True, highlight=False)
    console.print()

    counts = plain_table("agent", "key", "direction", "messages", "bytes", right=RIGHT)
    for row in sorted(audit["counts"], key=lambda row: (row["agent"], row["key"], row["direction"])):
        way = WAYS[row["direction"]]
        counts.add_row(row["agent"], escape(row["key"]), way, f"{row['messages']:,}", f"{row['bytes']:,}")
    console.print(counts, "")

    heard = plain_table("key asked for", "heard by, in the final look")
    for session in audit.get("sessions", {}).values():
        name = " and ".join(session["agents"]) or f"no agent, {session['address']}"
        for expression in session["heard"]:
            heard.add_row(escape(expression), escape(name))
    console.print(heard, "")

    carried = plain_table("connection", "of", "bytes to it", "explained", "bytes from it", "known by", right=RIGHT)
    for each in audit.get("connections", ()):
        figures = (f"{each[what]:,}" for what in ("bytes_to_it", "explained_at_most", "bytes_from_it"))
        carried.add_row(escape(each["from"]), escape(each["agent"]), *figures, escape(each["known"]))
    console.print(carried, "")

    for reason in audit["why"]:
        console.print(f"- {escape(reason)}", soft_wrap=True, highlight=False)
    verdict = audit["verdict"]
    console.print(f"no key reached two agents: [{VERDICT_STYLE.get(verdict, 'yellow')}]{escape(verdict)}[/]")


def _shown(value: object) -> str:
    return "" if value is None else escape(str(value))
