"""``palanquin chaos``: attacks and faults on purpose."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(help="Attack a run on purpose, and see what holds.", no_args_is_help=True)


@app.command()
def intruder(
    arm: Annotated[str, typer.Option(help="The arm whose credential the intruder has.")],
    other: Annotated[list[str], typer.Option(help="Another arm of the run; once per arm.")],
    run: Annotated[str, typer.Option("--run", help="Name of the run.")],
    connect: Annotated[str, typer.Option("--connect", help="Address of the simulator.")],
    overlay: Annotated[
        str, typer.Option(help="Zenoh configuration that proves who it is: a JSON file, or - for a line of stdin.")
    ] = "",
    private: Annotated[list[Path] | None, typer.Option(help="A file that it must not read.")] = None,
    pid: Annotated[list[int] | None, typer.Option(help="A process that it must not reach.")] = None,
    walls: Annotated[bool, typer.Option("--walls", help="Inside the walls that a launched follower has.")] = False,
) -> None:
    """Try everything that a hostile follower can try against a run that goes on; print one JSON object a row.

    Run it beside the healthy follower of the same arm. What arrived at others is told by the run's folder: see
    docs/silence.md.
    """
    from deploy.chaos.intruder import ATTEMPTS, try_all
    from deploy.chaos.target import Target
    from deploy.walls import SAYS, raise_walls
    from wire.endpoints import parse_endpoint
    from wire.keys import Keys

    for name in (arm, *other):
        Keys(run).arm(name)
    proof: dict[str, Any] = json.loads(_text(overlay)) if overlay else {}
    if walls:
        print(SAYS + raise_walls(parse_endpoint(connect).port, Path.cwd()), file=sys.stderr)
    target = Target(connect, run, arm, tuple(other), proof, tuple(private or ()), tuple(pid or ()))
    for row in try_all(target, ATTEMPTS):
        print(json.dumps({"name": row.name, "way": row.way, **asdict(row.got)}), flush=True)


def _text(place: str) -> str:
    return sys.stdin.readline() if place == "-" else Path(place).read_text(encoding="utf-8")
