"""``palanquin run``: a scenario from its file to its verdict, with all its processes on this machine."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

from rich.console import Console

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from agents.errors import GainError
from deploy.agents_told import guests_of
from deploy.exit_status import BAD_INPUT, COULD_NOT_RUN, fail
from deploy.guard import Interrupted
from deploy.launcher import Launcher, Show
from deploy.person.launched import led
from deploy.person.wishes import Wishes
from deploy.report import PatientConsole, print_metrics, progress_display
from deploy.see.viewing import RECORDING, viewer_command
from deploy.see.watch.beside import dashboard_beside
from deploy.see.watch.screens import why_plain
from deploy.settings import scenario_changes
from sim_server.errors import ScenarioError
from sim_server.run_folder import LOGS, METRICS, compute_metrics
from sim_server.scenario_files import NamedScenario, load_scenario
from sim_server.server import check_world, default_folder
from wire.access import Role
from wire.credentials import Guests
from wire.zenoh_link import free_endpoint, open_client

RUN_NAME = "carry"


def run_scenario(
    scenario: str,
    out: Path | None,
    seed: int | None,
    settings: Sequence[str] | None,
    *,
    picture: bool = True,
    record: bool = False,
    view: bool = False,
    viewer: str | None = None,
    watch: bool = False,
) -> int:
    """Launch it, show its progress, print what it left; the exit status.

    Args:
        scenario: a name or a file.
        out: the run folder; a dated one under runs/ by default.
        seed: another seed.
        settings: values to change, each ``KEY=VALUE``.
        picture: draw one of what it left.
        record: have an observer record it into its folder.
        view: have it shown in a viewer.
        viewer: have it shown in the one at this address.
        watch: have it shown in this terminal, in place of the bar.
    """
    console = PatientConsole()
    if watch and (lack := why_plain(console)):
        fail(f"--watch: {lack}, expected a terminal for the dashboard: leave --watch out", BAD_INPUT)
    arguments = ["--seed", str(seed)] if seed is not None else []
    for setting in settings or []:
        arguments += ["--set", setting]
    arguments += ["--", scenario]
    named = load_scenario(scenario, scenario_changes(seed, settings))
    sys.path.insert(0, os.getcwd())  # for a controller of the user's own
    _check_controller(named)
    check_world(named)
    if record or view or viewer:
        _check_recorder(view)
    folder = (out or default_folder(Path("runs"), named.name)).absolute()
    endpoint = free_endpoint()
    # The run's name is told to the followers; a scenario's name may say what no follower may know.
    guests = guests_of(named.scenario)
    recorder = [*(["--save", str(folder / RECORDING)] if record else []), *(["--view"] if view else [])]
    recorder += ["--viewer", viewer] if viewer else []
    wishes = Wishes()
    launcher = Launcher(arguments, named.scenario, RUN_NAME, endpoint, folder, guests, recorder, wishes)
    log = folder / LOGS / "watch.log"
    with (
        led(named.scenario, wishes.tell, console) as doing,
        dashboard_beside(endpoint, RUN_NAME, guests, named, arguments, log) if watch else nullcontext(),
    ):
        display = _no_display() if watch else progress_display(console, doing)
        try:
            status, problem = _carry(launcher, endpoint, guests, display)
        finally:
            launcher.end_all()
    return _conclude(console, folder, status, problem, picture=picture)


def _carry(launcher: Launcher, endpoint: str, guests: Guests, display: AbstractContextManager[Show]) -> tuple[int, str]:
    """Start everybody and watch them to the end; the exit status, and what went wrong, if anything did."""
    launcher.start()
    if launcher.sim.process.poll() is not None:
        fail(f"the simulator ended at its start: {launcher.sim.last_words()}", launcher.sim.process.returncode)
    with open_client(endpoint, guests.of(Role.OPERATOR)) as link, display as show:
        try:
            ended = launcher.watch(link, show)
            if launcher.sim.process.poll() is None:
                launcher.order_stop(link)
            return ended.status, ended.problem or launcher.wait_for_recorder()
        except Interrupted as interrupted:
            launcher.order_stop(link)
            launcher.wait_for_recorder()
            return COULD_NOT_RUN, str(interrupted)


@contextmanager
def _no_display() -> Iterator[Show]:
    """Where a dashboard has the terminal."""
    yield lambda _: None


def _check_recorder(view: bool) -> None:
    """See that there is what records, and who shows it, before anything starts."""
    importlib.import_module("deploy.see.recorder")
    if view:
        viewer_command()


def _check_controller(named: NamedScenario) -> None:
    """Make the law once, to see that it can be. Raises :class:`ScenarioError` for a gain, with file and key."""
    team = named.scenario.team
    try:
        make_controller(team.controller, ArmModel(team.arm), team.gains)
    except GainError as error:
        raise ScenarioError(Path(named.source).name, f"team.gains.{error.key}", error.problem) from None


def _conclude(console: Console, folder: Path, status: int, problem: str, *, picture: bool) -> int:
    """Print what a run left and draw its picture, if one is wanted; the exit status."""
    if (folder / METRICS).exists():
        metrics, judged = compute_metrics(folder)
        print_metrics(console, metrics, judged)
        drawn = _draw(folder) if picture else None
        console.print(
            f"run folder: {folder}" + (f" (picture: {drawn.name})" if drawn else ""), soft_wrap=True, markup=False
        )
    else:
        console.print(f"no metrics: the run did not end in order; run folder: {folder}", soft_wrap=True, markup=False)
    if problem:
        fail(problem, status)
    return status


def _draw(folder: Path) -> Path | None:
    """The run's picture; None without the extra ``view``."""
    try:
        from deploy.picture import draw_run
    except ModuleNotFoundError as missing:
        if missing.name is not None and missing.name.partition(".")[0] == "matplotlib":
            return None
        raise
    return draw_run(folder)
