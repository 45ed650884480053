"""The verbs of the chaos bench: ``palanquin chaos storm``, ``run``, ``judge``, ``shrink``, ``matrix``, ``lost``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from deploy.exit_status import COULD_NOT_RUN, OF_VERDICT

if TYPE_CHECKING:
    from deploy.chaos.catalogue import Fault
    from deploy.chaos.outcome import Judgement

app = typer.Typer()

STORM, SHRUNK = "storm.toml", "shrunk.toml"

Scenario = Annotated[
    str | None, typer.Option(help="A scenario's name or a TOML file; a short carry of one metre by default.")
]
Arms = Annotated[int | None, typer.Option(min=1, max=16, help="Arms of the team; 4 by default.")]
Preset = Annotated[str | None, typer.Option(help="The law: paper, palanquin, or module:Class of your own.")]
Seed = Annotated[int, typer.Option(min=0, help="Decides everything that is drawn, and the scenario's own seed.")]
Out = Annotated[Path | None, typer.Option(help="Where all goes; a dated folder under runs/ by default.")]
AtOnce = Annotated[int | None, typer.Option(min=1, help="Runs at a time; one per core by default.")]
Engine = Annotated[Literal["local", "ray"], typer.Option(help="Where runs are run.")]
RayAddress = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Of the Ray cluster.")]


@app.command()
def storm(
    seed: Seed = 1,
    faults: Annotated[int, typer.Option(min=0, help="How many faults are drawn.")] = 5,
    scenario: Scenario = None,
    arms: Arms = None,
    preset: Preset = None,
    out: Out = None,
    only: Annotated[list[str] | None, typer.Option(metavar="FAULT", help="Draw only these; may be repeated.")] = None,
    only_draw: Annotated[bool, typer.Option("--only-draw", help="Write the scenario, and run nothing.")] = False,
) -> None:
    """Draw a schedule of faults from a seed, run it, and hold the invariants against it.

    The schedule is a scenario file, storm.toml, that anybody can run again. Status 0 if all invariants hold, 1 if one
    is violated, 3 if one is unknown: a fault that was not seen to take effect makes the run unknown.
    """
    from deploy.chaos.printing import print_events
    from deploy.chaos.storm import carry_of, draw_storm, scenario_text

    carry = carry_of(scenario, arms, preset)
    events = draw_storm(carry, seed, faults, _rows(only) if only else None)
    folder = new_folder(out, f"storm-{seed}")
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / STORM
    file.write_text(
        scenario_text(carry, events, seed, f"A storm of {faults} faults, drawn from seed {seed}."), encoding="utf-8"
    )
    console = _console()
    print_events(console, events)
    console.print(f"scenario: {file}", soft_wrap=True, markup=False)
    if only_draw:
        return
    judgement = _run_and_print(console, str(file), folder / "run")
    if judgement.violated:
        console.print(f"cut it down: palanquin chaos shrink {shlex.quote(str(file))}", soft_wrap=True, markup=False)
    raise typer.Exit(OF_VERDICT[judgement.verdict])


@app.command("run")
def run_(
    scenario: Annotated[str, typer.Argument(help="A scenario's name or a TOML file.")],
    out: Annotated[Path | None, typer.Option(help="Run folder; a dated one under runs/ by default.")] = None,
) -> None:
    """Run a scenario and hold the invariants against it, in place of the scenario's own `[expect]`."""
    judgement = _run_and_print(_console(), scenario, new_folder(out, Path(scenario).stem))
    raise typer.Exit(OF_VERDICT[judgement.verdict])


@app.command()
def judge(folder: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]) -> None:
    """Hold the invariants against a run that is there."""
    from deploy.chaos.outcome import judge_folder
    from deploy.chaos.printing import print_judgement
    from sim_server.run_folder import read_run

    read_run(folder)
    judgement = judge_folder(folder)
    print_judgement(_console(), judgement)
    raise typer.Exit(OF_VERDICT[judgement.verdict])


@app.command()
def shrink(
    scenario: Annotated[str, typer.Argument(help="A scenario file whose run violates an invariant.")],
    out: Out = None,
    most: Annotated[int, typer.Option(min=1, help="Most runs.")] = 60,
) -> None:
    """Cut a schedule down to the fewest faults and smallest values that still violate the same invariant.

    Leaves shrunk.toml; `palanquin chaos run shrunk.toml` shows the violation. Every try is a run of its own, and those
    that are there are not run again. Status 0 if it was cut down, 3 if the run violates nothing.
    """
    from deploy.chaos.printing import print_events, print_judgement
    from deploy.chaos.shrink import shrink as cut_down
    from deploy.chaos.storm import carry_in, in_time, scenario_text
    from deploy.chaos.trials import failing_as, tried
    from sim_server.scenario_files import load_scenario
    from sim_server.server import default_folder

    named = load_scenario(scenario)
    seed, carry = named.scenario.seed, carry_in(scenario)
    events = in_time([event.model_dump(mode="json", exclude_none=True) for event in named.scenario.events])
    folder = (out or default_folder(Path("runs"), f"shrink-{named.name}")).absolute()
    console = _console()
    tries = folder / "tries"
    first = tried(carry.run("shrink", "whole", "", events, seed), tries)
    print_judgement(console, first)
    if not first.violated:
        console.print("it violates nothing: there is nothing to cut down", style="yellow")
        raise typer.Exit(COULD_NOT_RUN)
    fails = failing_as(first, carry, seed, tries, lambda line: console.print(line, markup=False, soft_wrap=True))
    shrunk = cut_down(events, fails, most)
    file = folder / SHRUNK
    what = f"{named.name}, cut down to what violates {first.violated[0].invariant}."
    file.write_text(scenario_text(carry, shrunk.events, seed, what), encoding="utf-8")
    print_events(console, shrunk.events)
    if not shrunk.is_done:
        console.print(f"{most} runs were not enough to know that no less violates it", style="yellow")
    console.print(f"palanquin chaos run {shlex.quote(str(file))}", soft_wrap=True, markup=False)


@app.command()
def matrix(
    out: Annotated[Path, typer.Option(help="Where runs and report go; runs that are there are not run again.")] = Path(
        "runs/matrix"
    ),
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of every cell.")] = 10,
    arms: Annotated[list[int] | None, typer.Option(min=1, max=16, help="May be repeated; 4 and 6 by default.")] = None,
    preset: Annotated[list[str] | None, typer.Option(help="May be repeated; paper and palanquin by default.")] = None,
    only: Annotated[list[str] | None, typer.Option(metavar="FAULT", help="Only these; may be repeated.")] = None,
    at_once: AtOnce = None,
    engine: Engine = "local",
    ray_address: RayAddress = None,
) -> None:
    """Every fault, by every team, under every law, over seeds: where the team carries, where it stops, where it drops.

    Leaves matrix.md, matrix.json and survival.png. Status 0 if all invariants hold in all runs, 1 if one is violated, 3
    if one is unknown or a run is missing.
    """
    from deploy.batch import engine_of
    from deploy.chaos.matrix import describe, judged, plan_matrix, report, table
    from deploy.chaos.outcome import verdict_of
    from deploy.chaos.printing import runs_bar
    from deploy.chaos.survival_map import draw_map
    from deploy.chaos.trials import cost_text, try_all
    from sim_server.run_folder import write_json

    cells = plan_matrix(_rows(only), arms or [4, 6], preset or ["paper", "palanquin"], range(1, 1 + seeds))
    runs, console = [run for cell in cells for run in cell.runs], _console()
    out.mkdir(parents=True, exist_ok=True)
    with runs_bar(console) as told:
        found = judged(cells, try_all(runs, out, engine_of(engine, at_once, ray_address), told))
    command, picture = "palanquin " + shlex.join(sys.argv[1:]), "survival.png"
    draw_map(found, out / picture)
    (out / "matrix.md").write_text(report(found, command, cost_text(runs, out), picture), encoding="utf-8")
    write_json(out / "matrix.json", describe(found, out, command))
    console.print(table(found), markup=False, soft_wrap=True)
    console.print(f"report: {out / 'matrix.md'}, {out / picture}", soft_wrap=True, markup=False)
    findings = [finding for each in found for judgement in each.judgements for finding in judgement.findings]
    raise typer.Exit(OF_VERDICT[verdict_of(findings)])


@app.command()
def lost(
    ticks: Annotated[int, typer.Option(min=1, help="How many losses are drawn, each at a tick of its own.")] = 200,
    seed: Seed = 1,
    preset: Annotated[str, typer.Option(help="The law: paper, palanquin, or module:Class of your own.")] = "paper",
    out: Annotated[Path, typer.Option(help="Where runs go; those that are there are not run again.")] = Path(
        "runs/lost"
    ),
    at_once: AtOnce = None,
    engine: Engine = "local",
    ray_address: RayAddress = None,
) -> None:
    """Lose any one follower of `transport` in any way, at drawn ticks: the worst tilt, height and goal error."""
    from deploy.batch import engine_of
    from deploy.chaos.lost import draw_losses, rows_of, run_of
    from deploy.chaos.outcome import OUTCOMES, verdict_of
    from deploy.chaos.printing import runs_bar
    from deploy.chaos.trials import cost_text, try_all
    from deploy.report import plain_table
    from sim_server.scenario_files import load_scenario

    losses = draw_losses(load_scenario("transport").scenario.arms, ticks, seed)
    runs, console = [run_of(loss, preset, seed) for loss in losses], _console()
    with runs_bar(console) as told:
        by_place = try_all(runs, out, engine_of(engine, at_once, ray_address), told)
    judgements = [by_place[run.place] for run in runs]
    numbers = ("tilt deg", "low m", "goal m")
    table = plain_table("loss, arm", *OUTCOMES, *numbers, right=(*OUTCOMES, *numbers))
    for row in rows_of(losses, judgements):
        worst = (row.tilt_max_deg, row.height_min_m, row.goal_error_m)
        texts = ("" if number is None else f"{number:.3g}" for number in worst)
        table.add_row(row.name, *(str(row.outcomes[outcome]) for outcome in OUTCOMES), *texts)
    console.print(table)
    console.print(cost_text(runs, out), soft_wrap=True)
    raise typer.Exit(OF_VERDICT[verdict_of([finding for each in judgements for finding in each.findings])])


def _rows(names: list[str] | None) -> tuple[Fault, ...]:
    """The faults of these names."""
    from deploy.chaos.catalogue import named

    try:
        return named(names or [])
    except ValueError as error:
        raise typer.BadParameter(f"--only: {error}") from None


def new_folder(out: Path | None, name: str) -> Path:
    """The folder that was asked for, or a dated one. Raises RunFolderError if there is something in it."""
    from sim_server.run_folder import RunFolderError
    from sim_server.server import default_folder

    folder = (out or default_folder(Path("runs"), name)).absolute()
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise RunFolderError(f"{folder} is there already: expected a new or an empty folder; choose another with --out")
    return folder


def _console() -> Console:
    from deploy.report import PatientConsole

    return PatientConsole()


def _run_and_print(console: Console, scenario: str, folder: Path) -> Judgement:
    from deploy.chaos.printing import print_judgement
    from deploy.chaos.trials import try_one
    from deploy.planned_run import Run
    from sim_server.scenario_files import load_scenario

    seed = load_scenario(scenario).scenario.seed
    with console.status("carrying"):
        judgement = try_one(Run("chaos", Path(scenario).stem, "", scenario, {}, seed, may_lose=True), folder)
    print_judgement(console, judgement)
    console.print(f"run folder: {folder}", soft_wrap=True, markup=False)
    return judgement
