"""``palanquin chaos``: attacks and faults on purpose."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from deploy.chaos.bench_commands import app as bench_app
from deploy.chaos.fuzz.commands import app as fuzz_app
from deploy.exit_status import COULD_NOT_RUN
from wire.errors import CredentialError

Engine = Literal["docker"]

app = typer.Typer(help="Attack a run on purpose, and see what holds.", no_args_is_help=True)
app.add_typer(bench_app)
app.add_typer(fuzz_app)


@app.command()
def intruder(
    tls: Annotated[bool, typer.Option("--tls", help="Protect with certificates (mTLS) instead of passwords.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder of the report; a dated one under runs/ by default.")] = None,
    arms: Annotated[int, typer.Option(min=2, max=16, help="Arms of the team that is attacked.")] = 4,
    only_protected: Annotated[
        bool, typer.Option("--only-protected", help="Leave out the open system and the run without an intruder.")
    ] = False,
) -> None:
    """Let a hostile follower with the credential of one arm try everything, on an open system and on a protected one.

    Prints what each attempt gave on either and leaves a report. Status 0 if all are closed here and the trace is that
    of the run without an intruder, 1 if not, 3 if the intruder's own session did not work in some attempt: that row is
    then not tested.
    """
    from deploy.chaos.comparison import compare
    from deploy.chaos.comparison_report import print_and_write, status
    from deploy.report import PatientConsole
    from sim_server.server import default_folder

    folder = (out or default_folder(Path("runs"), "intruder")).absolute()
    console = PatientConsole()
    comparison = compare(folder, console.print, arms=arms, tls=tls, only_protected=only_protected)
    print_and_write(console, comparison, folder)
    raise typer.Exit(status(comparison))


@app.command()
def attack(
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
    """Be the intruder of a run that goes on; print one JSON object a row.

    Run it beside the healthy follower of the same arm. What arrived at others is told by the run's folder: see
    docs/silence.md.
    """
    from deploy.chaos.intruder import ATTEMPTS, try_all
    from deploy.chaos.target import Target
    from deploy.walls import shut_in
    from wire.endpoints import parse_endpoint
    from wire.keys import Keys

    for name in (arm, *other):
        Keys(run).arm(name)
    proof = _overlay(overlay) if overlay else {}
    parse_endpoint(connect)
    if walls:
        print(shut_in(connect), file=sys.stderr)
    target = Target(connect, run, arm, tuple(other), proof, tuple(private or ()), tuple(pid or ()))
    for row in try_all(target, ATTEMPTS):
        print(json.dumps({"name": row.name, "way": row.way, **asdict(row.got)}), flush=True)


@app.command()
def deeds(
    engine: Annotated[Engine, typer.Option(help="What runs the agents.")],
    run: Annotated[str, typer.Option("--run", help="Name of the run.")] = "carry",
    connect: Annotated[str, typer.Option("--connect", help="Address of the simulator.")] = "tls/localhost:7447",
    credential: Annotated[
        str | None, typer.Option("--credential", metavar="DIR", help="The operator's; - reads a line of stdin.")
    ] = None,
    wait_s: Annotated[float, typer.Option("--wait-s", min=0.0, help="Wait so long for the simulator.")] = 60.0,
) -> None:
    """Do to containers what the scenario of a run wants done to processes.

    Ends with the simulator: status 0, or 3 if a deed could not be done.
    """
    from deploy.chaos.containers import do_deeds
    from deploy.docker_engine import Docker
    from deploy.links import own_credential
    from wire.access import Role

    own = own_credential(credential, Role.OPERATOR)
    failed = do_deeds(Docker(run, engine), run, connect, own, wait_s, lambda text: print(text, flush=True))
    raise typer.Exit(COULD_NOT_RUN if failed else 0)


def _overlay(place: str) -> dict[str, Any]:
    """The JSON object in a file, or in the next line of standard input. Raises :class:`CredentialError`."""
    try:
        found = json.loads(sys.stdin.readline() if place == "-" else Path(place).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else f"not JSON: {error}"
        raise CredentialError(f"--overlay {place}: cannot be read ({why}); expected a JSON object") from None
    if not isinstance(found, dict):
        raise CredentialError(f"--overlay {place}: got a {type(found).__name__}, expected a JSON object")
    return found
