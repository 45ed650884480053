"""The verb ``palanquin leader``: who leads, a law or a person, and where to."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from agents.waypoints import NEAR_M
from agents.wish import Wish
from deploy.exit_status import COULD_NOT_RUN
from deploy.guard import end_with_parent, leave_on_signals
from deploy.options import (
    DEFAULT_ENDPOINT,
    RECONNECT_S,
    Connect,
    OwnCredential,
    Reconnect,
    RunName,
    Walls,
    WithParent,
    log_to_stderr,
    raise_walls,
)
from deploy.person.attending import HELP, Attended, Device, attended

CLEAR_LINE = "\r\x1b[K"


def leader(
    run: RunName,
    goal_m: Annotated[
        tuple[float, float] | None,
        typer.Option("--goal-m", metavar="X Y", help="Where the load shall go, m. Needed unless a person leads."),
    ] = None,
    connect: Connect = DEFAULT_ENDPOINT,
    stop: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y,UNTIL_S", help="Pull there first, until that simulated time; may be repeated."),
    ] = None,
    waypoint: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y", help="Pull there first, until the load has come near; may be repeated."),
    ] = None,
    near_m: Annotated[
        float, typer.Option("--near-m", min=0.0, help="From where on a waypoint counts as reached, m.")
    ] = NEAR_M,
    keyboard: Annotated[
        bool, typer.Option("--keyboard", help="A person leads, with the keys of this terminal.")
    ] = False,
    gamepad: Annotated[bool, typer.Option("--gamepad", help="A person leads, with a gamepad.")] = False,
    wishes: Annotated[
        bool, typer.Option("--wishes", help="A person leads, by lines of stdin: pull X Y (-1 to 1), brake, leave.")
    ] = False,
    force_max: Annotated[float, typer.Option("--force-max-N", min=0.0)] = 40.0,
    stiffness: Annotated[float, typer.Option("--stiffness-N-m", min=0.0)] = 100.0,
    damping: Annotated[float, typer.Option("--damping-Ns-m", min=0.0)] = 320.0,
    point: Annotated[str, typer.Option(help="Point of the load that is pulled.")] = "front",
    wait_s: Annotated[
        float, typer.Option("--wait-s", min=0.0, help="Stand in line so long while another leader is in.")
    ] = 0.0,
    walls: Walls = False,
    credential: OwnCredential = None,
    reconnect_s: Reconnect = RECONNECT_S,
    with_parent: WithParent = False,
) -> None:
    """Start the leader: it sees the load, knows the goal or obeys a person, and pulls."""
    from agents.leader import LeaderSettings, LeaderSettingsError, Stop, read_waypoint, run_leader
    from agents.person import Person
    from deploy.links import own_credential
    from wire.keys import Keys
    from wire.zenoh_link import open_client

    log_to_stderr()
    if keyboard + gamepad + wishes > 1:
        raise LeaderSettingsError("leader: who leads? Got several of --keyboard, --gamepad, --wishes; expected one")
    by_person = keyboard or gamepad or wishes
    if goal_m is None and not by_person:
        raise LeaderSettingsError("leader: where to? Give --goal-m X Y, or let a person lead: --keyboard or --gamepad")
    if by_person and (stop or waypoint):
        raise LeaderSettingsError("leader: got a way and a person, expected one of the two: both would lead")
    settings = LeaderSettings(
        run,
        goal_m or (0.0, 0.0),  # a person has none, and it is not looked at
        force_max,
        stiffness,
        damping,
        point,
        stops=tuple(map(Stop.read, stop or [])),
        wait_s=wait_s,
        reconnect_s=reconnect_s,
        waypoints=tuple(map(read_waypoint, waypoint or [])),
        near_m=near_m,
    )
    Keys(run)
    own = own_credential(credential, "leader")
    with _at_device("keyboard" if keyboard else "gamepad" if gamepad else None) as device:
        if walls:
            raise_walls(connect)
        leave_on_signals()
        person = Person(_interrupt_main_thread, _shown(force_max)) if by_person else None
        if with_parent:
            hear = person.hear if person else lambda said: None
            end_with_parent(lambda: os._exit(COULD_NOT_RUN), even_if_stopped=True, hear=hear)
        elif wishes and person:
            end_with_parent(person.hear_end, even_if_stopped=False, hear=person.hear)
        if device and person:
            device.hand_on(person.hear, person.hear_end)
        with open_client(connect, own) as link:
            why = run_leader(link, settings, person)
            if device and sys.stderr.isatty():
                print(CLEAR_LINE, end="", file=sys.stderr, flush=True)
            print(f"leader: {why}")


@contextmanager
def _at_device(device: Device | None) -> Iterator[Attended | None]:
    """The person at it, who is told what can be done with it."""
    if device is None:
        yield None
        return
    with attended(device) as person:
        print(HELP[device], file=sys.stderr, flush=True)
        yield person


def _shown(force_max_N: float) -> Callable[[Wish], None]:
    """Shows each wish: in one line of the terminal, where there is one."""
    if not sys.stderr.isatty():
        return lambda wish: None
    return lambda wish: print(
        f"{CLEAR_LINE}{wish.says(force_max_N)}", end="\n" if wish.leave else "", file=sys.stderr, flush=True
    )


def _interrupt_main_thread() -> None:
    """As Ctrl-C does, wherever it waits."""
    main = threading.main_thread().ident
    if main is not None:
        signal.pthread_kill(main, signal.SIGINT)
