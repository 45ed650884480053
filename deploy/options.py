"""Options that several verbs have."""

from __future__ import annotations

import logging
from typing import Annotated

import typer

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
RECONNECT_S = 30.0
"""Time to start a simulator that was killed again, by hand. Agents of a launched run end with it."""

Settings = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one value (TOML).")]
RunName = Annotated[str, typer.Option("--run", help="Name of the run.")]
Connect = Annotated[str, typer.Option("--connect", help="Address of the simulator.")]
OwnCredential = Annotated[
    str | None, typer.Option("--credential", metavar="DIR", help="This process's credential; - reads a line of stdin.")
]
Reconnect = Annotated[
    float, typer.Option("--reconnect-s", min=0.0, help="Wait so long for a simulator that is gone; 0: end with it.")
]
WithParent = Annotated[bool, typer.Option("--with-parent", hidden=True)]
Walls = Annotated[
    bool,
    typer.Option("--walls", help="Shut this process in: its working folder and the simulator's port only (Linux)."),
]


def log_to_stderr() -> None:
    """What a verb logs, each line with its time."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s")


def raise_walls(connect: str) -> None:
    """Shut this process in, and say so."""
    from deploy.walls import shut_in

    print(shut_in(connect), flush=True)
