"""``palanquin view``, ``watch``, ``record``, ``render``, ``plot``: what can be seen of runs."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

RunFolderPath = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]


def view(
    folder: RunFolderPath,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the recording there; no viewer.")] = None,
) -> None:
    """Open a run in the Rerun viewer: its recording, or one that is made of its trace."""
    from deploy.see.viewing import save_recording, view_run

    if save is None:
        view_run(folder)
        return
    save_recording(folder, save)
    print(save)


def record(
    scenario: Annotated[str, typer.Argument(help="The scenario that the simulator was started with.")],
    run: Annotated[str, typer.Option("--run", help="Name of the run.")],
    connect: Annotated[str, typer.Option("--connect", help="Address of the simulator.")] = "tcp/127.0.0.1:7447",
    credential: Annotated[
        str | None, typer.Option("--credential", metavar="DIR", help="The observer's; - reads a line of stdin.")
    ] = None,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the recording there (.rrd).")] = None,
    view_: Annotated[bool, typer.Option("--view", help="Show it in a viewer meanwhile.")] = False,
    viewer: Annotated[str | None, typer.Option(metavar="URL", help="Show it in a viewer that is there.")] = None,
    wait_s: Annotated[float, typer.Option("--wait-s", min=0.0, help="Wait so long for the simulator.")] = 10.0,
    seed: Annotated[int | None, typer.Option(help="As the simulator was told.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Likewise.")] = None,
    with_parent: Annotated[bool, typer.Option("--with-parent", hidden=True)] = False,
) -> None:
    """Record a run while it goes on: an observer of its own, which the simulator does not wait for."""
    from deploy.exit_status import BAD_INPUT, COULD_NOT_RUN, fail
    from deploy.guard import end_with_parent, stop_on_signals
    from deploy.links import own_credential
    from deploy.see.recorder import Recorder, open_viewer
    from deploy.see.recorder import record as record_run
    from deploy.settings import scenario_changes
    from sim_server.scenario_files import load_scenario
    from wire.zenoh_link import open_client

    if save is None and not view_ and viewer is None:
        fail("where to? Give --save FILE, --view, or --viewer URL", BAD_INPUT)
    if save is not None and not save.absolute().parent.is_dir():
        fail(f"--save {save}: there is no folder {save.absolute().parent}", BAD_INPUT)
    named = load_scenario(scenario, scenario_changes(seed, set_))
    own = own_credential(credential, "observer")
    address = open_viewer() if view_ else viewer
    with open_client(connect, own) as link:
        recorder = Recorder(link, run, named.scenario.record.every_ticks)
        stop_on_signals(recorder.stop)
        if with_parent:
            end_with_parent(recorder.stop, even_if_stopped=False)
        done = record_run(recorder, named, file=save, viewer=address, wait_s=wait_s)
    print(f"{done.rows} rows recorded, {done.lost} lost, {done.refused} refused", flush=True)
    if done.viewer_hangs:
        print("palanquin: the viewer did not take all of it: it is gone, or hangs", file=sys.stderr, flush=True)
        os._exit(COULD_NOT_RUN)


def watch(
    run: Annotated[str, typer.Option("--run", help="Name of the run.")],
    scenario: Annotated[
        str | None, typer.Argument(help="What the simulator was started with; the view from above needs it.")
    ] = None,
    connect: Annotated[str, typer.Option("--connect", help="Address of the simulator.")] = "tcp/127.0.0.1:7447",
    credential: Annotated[
        str | None, typer.Option("--credential", metavar="DIR", help="The observer's; - reads a line of stdin.")
    ] = None,
    wait_s: Annotated[float, typer.Option("--wait-s", min=0.0, help="Wait so long for the simulator.")] = 10.0,
    reconnect_s: Annotated[
        float, typer.Option("--reconnect-s", min=0.0, help="Wait so long for a simulator that is gone.")
    ] = 10.0,
    plain: Annotated[bool, typer.Option("--plain", help="Lines instead of a picture.")] = False,
    ascii_: Annotated[bool, typer.Option("--ascii", help="No braille, no blocks.")] = False,
    seed: Annotated[int | None, typer.Option(help="As the simulator was told.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Likewise.")] = None,
    with_parent: Annotated[bool, typer.Option("--with-parent", hidden=True)] = False,
) -> None:
    """Watch a run in the terminal while it goes on: an observer of its own, which the simulator does not wait for."""
    from deploy.guard import end_with_parent, stop_on_signals
    from deploy.links import own_credential
    from deploy.patient_console import PatientConsole
    from deploy.see.watch.watcher import Watcher
    from deploy.see.watch.watching import told_by, watch_run
    from deploy.settings import scenario_changes
    from sim_server.scenario_files import load_scenario
    from wire.keys import Keys
    from wire.zenoh_link import open_client

    Keys(run)
    named = None if scenario is None else load_scenario(scenario, scenario_changes(seed, set_))
    own = own_credential(credential, "observer")
    with open_client(connect, own, timeout_s=wait_s) as link:
        watcher = Watcher(link, run)
        stop_on_signals(watcher.stop)
        if with_parent:
            end_with_parent(watcher.stop, even_if_stopped=False)
        watcher.wait_for_simulator(wait_s)
        status = watch_run(
            watcher,
            PatientConsole(),
            told_by(None if named is None else named.scenario),
            reconnect_s=reconnect_s,
            plain=plain,
            ascii_only=ascii_,
            says_farewell=not with_parent,
        )
    raise typer.Exit(status)


def render(
    folder: RunFolderPath,
    out: Annotated[
        Path, typer.Option(help="A .png, .gif or .mp4, or a new folder for single pictures of a film.")
    ] = Path("still.png"),
    time_s: Annotated[float, typer.Option("--time-s", min=0.0, help="Moment of a still.")] = 0.0,
    from_s: Annotated[float, typer.Option("--from-s", min=0.0, help="Where a film begins.")] = 0.0,
    to_s: Annotated[
        float | None, typer.Option("--to-s", min=0.0, help="Where it ends; with the run by default.")
    ] = None,
    fps: Annotated[float | None, typer.Option(min=0.1, max=120.0, help="Pictures a second of a film.")] = None,
    speed: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Simulated time over the film's.")] = 1.0,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Pixels, at most 1280x720.")] = None,
    marks: Annotated[bool, typer.Option("--marks/--no-marks", help="Draw the goal and the forces.")] = True,
    caption: Annotated[bool, typer.Option("--caption/--no-caption", help="Write time and numbers below.")] = True,
) -> None:
    """Render a run off-screen from its trace: a still (PNG), a film (GIF, MP4), or the film's pictures."""
    from deploy.see.rendering import Wanted, parse_size
    from deploy.see.rendering import render as render_run

    wanted = Wanted(time_s, from_s, to_s, fps, speed, parse_size(size), marks, caption)
    render_run(folder, out, wanted)
    print(out)


def plot(
    folders: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run folders; several are compared.")],
    out: Annotated[Path, typer.Option(help="Folder for the figures; made if it is not there.")] = Path("plots"),
    only: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="These questions only, such as goal,tilt; all by default.")
    ] = None,
    format_: Annotated[str, typer.Option("--format", help="png, svg or pdf.")] = "png",
) -> None:
    """Plot runs beside each other: a figure for each question."""
    from deploy.see.plots import plot_runs

    for file in plot_runs(folders, out, only, format_):
        print(file)
