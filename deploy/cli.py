"""The command ``palanquin``. Exit status: 0 holds, 1 violated, 2 bad input, 3 could not run or cannot tell."""

from __future__ import annotations

import os

# Before numpy is loaded: one thread per process, since the matrices are small and more threads only disturb each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import importlib.metadata
import logging
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from deploy.bench.commands import bench
from deploy.chaos.commands import app as chaos_app
from deploy.credentials_cli import credentials, router
from deploy.exit_status import BAD_INPUT, COULD_NOT_RUN, OF_VERDICT, fail, one_sentence
from deploy.guard import end_with_parent, leave_on_signals, raise_on_signals, stop_on_signals, stop_or_exit
from deploy.leader_cli import leader
from deploy.options import (
    DEFAULT_ENDPOINT,
    RECONNECT_S,
    Connect,
    OwnCredential,
    Reconnect,
    RunName,
    Settings,
    Walls,
    WithParent,
    log_to_stderr,
    raise_walls,
)
from deploy.paper.commands import paper, verify
from deploy.see.commands import plot, render
from deploy.see.commands import record as record_run
from deploy.see.commands import view as view_run
from deploy.see.commands import watch as watch_run
from deploy.settings import scenario_changes, tables

LONGEST_S = 3600.0
"""Of a time that something takes: an hour, and no infinity."""

app = typer.Typer(
    name="palanquin",
    help="Robots that carry one load together without talking.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

app.add_typer(chaos_app, name="chaos")

ScenarioName = Annotated[str, typer.Argument(help="A scenario's name (see `palanquin scenarios`) or a TOML file.")]


@app.callback(invoke_without_command=True)
def _main(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    if version:
        print(importlib.metadata.version("palanquin"))
        raise typer.Exit


@app.command()
def run(
    scenario: ScenarioName,
    out: Annotated[Path | None, typer.Option(help="Run folder; a dated one under runs/ by default.")] = None,
    seed: Annotated[int | None, typer.Option(help="Another seed.")] = None,
    picture: Annotated[bool, typer.Option("--picture/--no-picture", help="Draw run.png.")] = True,
    record: Annotated[bool, typer.Option("--record", help="Record run.rrd for the Rerun viewer.")] = False,
    view: Annotated[bool, typer.Option("--view", help="Show the run in the viewer while it goes on.")] = False,
    viewer: Annotated[str | None, typer.Option(metavar="URL", help="Show it in a viewer that is there.")] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Show it in this terminal while it goes on.")] = False,
    leader: Annotated[
        Literal["law", "keyboard", "gamepad"] | None,
        typer.Option("--leader", help="Who leads: the scenario's law, or a person at this machine."),
    ] = None,
    set_: Settings = None,
) -> None:
    """Run a scenario: simulator, followers and leader as processes of this machine."""
    from deploy.running import run_scenario

    if leader is not None:
        set_ = [*(set_ or []), f'leader.by="{leader}"']
    status = run_scenario(
        scenario, out, seed, set_, picture=picture, record=record, view=view, viewer=viewer, watch=watch
    )
    raise typer.Exit(status)


@app.command()
def sim(
    scenario: Annotated[
        str | None, typer.Argument(help="A scenario's name or a TOML file; with --resume, RUN's.")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Go on with the run in this folder, whose simulator was killed."),
    ] = None,
    run: Annotated[str | None, typer.Option("--run", help="Name of the run; the scenario's by default.")] = None,
    listen: Annotated[str, typer.Option(help="Address to listen on.")] = DEFAULT_ENDPOINT,
    connect_router: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Be a client of this router instead of listening.")
    ] = None,
    credentials: Annotated[
        str | None, typer.Option(metavar="DIR", help="The simulator's credential, DIR/sim; - reads a line of stdin.")
    ] = None,
    open_: Annotated[
        bool, typer.Option("--open", help="No access rules: anyone on this machine may listen and command.")
    ] = False,
    insecure_network: Annotated[
        bool, typer.Option("--insecure-network", help="Listen to other machines without certificates.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Run folder; a dated one under runs/ by default.")] = None,
    seed: Annotated[int | None, typer.Option(help="Another seed.")] = None,
    set_: Settings = None,
    uncounted: Annotated[bool, typer.Option("--uncounted", hidden=True)] = False,
    with_parent: WithParent = False,
) -> None:
    """Start the simulator of a scenario and wait for its agents."""
    from deploy.links import OPEN_MEANS, open_sim_link
    from deploy.resuming import checkpoint_to_resume
    from sim_server.run_folder import RunFolder
    from sim_server.scenario_files import load_scenario
    from sim_server.server import Server, check_world, default_folder
    from wire.endpoints import parse_endpoint

    log_to_stderr()
    checkpoint = checkpoint_to_resume(resume, scenario, scenario_changes(seed, set_), run, out)
    if checkpoint is not None:
        named, name = checkpoint.named, checkpoint.run
    elif scenario is not None:
        named = load_scenario(scenario, scenario_changes(seed, set_))
        name = run or _run_name(named.name)
    else:
        fail("which scenario? Give SCENARIO, or --resume RUN to go on with a run whose simulator was killed", BAD_INPUT)
    check_world(named)
    with open_sim_link(
        name, listen, connect_router, credentials, is_open=open_, insecure_network=insecure_network
    ) as link:
        again = None if checkpoint is None else RunFolder.of_a_run(checkpoint.folder)
        folder = again or RunFolder(out or default_folder(Path("runs"), named.name))
        # Uncounted: `palanquin bench` measures what it costs to count. The audit is then unknown.
        listening = None if connect_router or uncounted else parse_endpoint(listen)
        server = Server(link, named, name, folder, names_proven=not open_, listening=listening, checkpoint=checkpoint)
        stop_on_signals(server.stop)
        if with_parent:
            end_with_parent(lambda: stop_or_exit(server.stop), even_if_stopped=False)
        if open_:
            print(f"open: {OPEN_MEANS}")
        print(f"run {name} at {connect_router or listen}, waiting for {', '.join(named.scenario.arms)}", flush=True)
        outcome = server.run()
        print(f"{outcome.verdict}: {outcome.why}; run folder: {folder.path}", flush=True)
        if outcome.link_hangs:  # it would hang in closing as well; everything is written
            logging.shutdown()
            sys.stderr.flush()
            os._exit(OF_VERDICT[outcome.verdict])
    raise typer.Exit(OF_VERDICT[outcome.verdict])


@app.command()
def follower(
    arm: Annotated[str, typer.Option(help="Name of the arm, such as a1.")],
    run: RunName,
    connect: Connect = DEFAULT_ENDPOINT,
    arm_model: Annotated[str, typer.Option(help="The arm's description.")] = "panda",
    controller: Annotated[str, typer.Option(help="A law's name, or module:Class for your own.")] = "paper",
    handover_s: Annotated[
        float, typer.Option(min=0.0, max=LONGEST_S, help="Time over which the law takes the load over.")
    ] = 1.0,
    leave_s: Annotated[
        float,
        typer.Option(
            min=0.0, max=LONGEST_S, help="Time over which it lets its share down when SIGTERM tells it to leave."
        ),
    ] = 2.0,
    set_: Settings = None,
    walls: Walls = False,
    credential: OwnCredential = None,
    reconnect_s: Reconnect = RECONNECT_S,
    with_parent: WithParent = False,
) -> None:
    """Start one follower: the control process of one arm."""
    from agents.departure import Departure
    from agents.follower import FollowerSettings, run_follower
    from deploy.links import own_credential
    from wire.keys import Keys
    from wire.zenoh_link import open_client

    log_to_stderr()
    sys.path.insert(0, os.getcwd())  # for a controller of the user's own
    own = own_credential(credential, arm)
    if walls:  # all of ours is loaded, nothing of the user's
        raise_walls(connect)
    gains = tables(set_ or [])
    settings = FollowerSettings(run, arm, arm_model, controller, gains, handover_s, leave_s, reconnect_s=reconnect_s)
    Keys(run).arm(arm)
    if with_parent:
        end_with_parent(lambda: os._exit(COULD_NOT_RUN), even_if_stopped=True)
    departure = Departure()
    leave_on_signals(departure.ask)
    with open_client(connect, own) as link:
        print(f"{arm}: {run_follower(link, settings, departure)}")


app.command()(leader)


@app.command()
def join(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a run that goes on.")],
    strut: Annotated[
        int, typer.Option(min=1, max=16, help="Number of the free strut that the new robot shall take, from 1.")
    ],
) -> None:
    """Let a new robot come to a run that goes on: it drives in, takes hold of a free strut, and carries on."""
    from deploy.joining import join_run

    join_run(folder, strut)


app.command()(credentials)
app.command()(router)
app.command()(paper)
app.command()(verify)
app.command()(bench)
app.command(name="view")(view_run)
app.command(name="watch")(watch_run)
app.command(name="record")(record_run)
app.command()(render)
app.command()(plot)


@app.command()
def scenarios() -> None:
    """List the scenarios that come with Palanquin."""
    from deploy.report import print_scenarios
    from sim_server.scenario_files import load_scenario, shipped_names

    print_scenarios(Console(), [(name, load_scenario(name).scenario.description) for name in shipped_names()])


@app.command()
def metrics(folder: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]) -> None:
    """Compute a run's metrics.json again from its trace."""
    from deploy.report import print_metrics
    from sim_server.run_folder import METRICS, compute_metrics, write_json

    found, judged = compute_metrics(folder)
    write_json(folder / METRICS, found)
    print_metrics(Console(), found, judged)


@app.command()
def audit(folder: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]) -> None:
    """Say who heard what in a run, and whether any key reached two agents."""
    from deploy.audit_report import print_audit
    from sim_server.run_folder import read_audit

    found = read_audit(folder)
    print_audit(Console(), found, folder)
    raise typer.Exit(OF_VERDICT.get(found["verdict"], COULD_NOT_RUN))


def _run_name(name: str) -> str:
    """A scenario's name as part of a key."""
    kept = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in name.lower()).strip("-")
    return kept[:40] or "run"


def main() -> None:
    """Every error that we raise on purpose becomes one sentence and an exit status."""
    with one_sentence():
        raise_on_signals()
        app()


if __name__ == "__main__":
    main()
