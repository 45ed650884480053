"""The verbs ``credentials`` and ``router``: who may take part, and the process that sees to it."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wire.errors import CredentialError

if TYPE_CHECKING:
    from deploy.credential_store import Entry

DEFAULT_DAYS = 365
DEFAULT_LISTEN = "tls/0.0.0.0:7447"


def credentials(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of all credentials; made if it is not there.")],
    arms: Annotated[int | None, typer.Option(min=1, max=1000, help="Make them for the arms a1 to aN.")] = None,
    arm: Annotated[list[str] | None, typer.Option(help="Make one for this arm (several times for several).")] = None,
    days: Annotated[int, typer.Option(help="Days until what is made now expires.")] = DEFAULT_DAYS,
    host: Annotated[
        list[str] | None, typer.Option(help="Name or address under which other machines reach the simulator.")
    ] = None,
    revoke: Annotated[str | None, typer.Option(metavar="NAME", help="Let this one in no more.")] = None,
    rotate: Annotated[str | None, typer.Option(metavar="NAME", help="Make this one anew; the old is useless.")] = None,
    list_: Annotated[bool, typer.Option("--list", help="Who has one, until when, with which fingerprint.")] = False,
    router_config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the rules of one run for an external router.")
    ] = None,
    run: Annotated[str | None, typer.Option(help="With --router-config: the run's name.")] = None,
    listen: Annotated[str, typer.Option(help="With --router-config: where it listens.")] = DEFAULT_LISTEN,
) -> None:
    """Make, list, renew and revoke the credentials of a team; leader, observer and operator get theirs too."""
    from deploy.credential_store import CredentialStore
    from deploy.router_file import write_router_file

    wanted = [*(f"a{k}" for k in range(1, (arms or 0) + 1)), *(arm or [])]
    asked = [bool(wanted), revoke is not None, rotate is not None, list_, router_config is not None]
    if sum(asked) != 1:
        raise CredentialError(
            "one thing at a time: expected --arms N or --arm NAME, or --revoke, --rotate, --list, --router-config"
        )
    _check_goes_together(
        {
            "--days": (days != DEFAULT_DAYS, bool(wanted) or rotate is not None),
            "--host": (host is not None, bool(wanted)),
            "--run": (run is not None, router_config is not None),
            "--listen": (listen != DEFAULT_LISTEN, router_config is not None),
        }
    )
    if wanted and not CredentialStore.is_one(folder):
        store = CredentialStore.create(folder, wanted, days=days, hosts=host or [])
        print(f"{folder}: credentials for {', '.join(entry.name for entry in store.entries())}; {_how_to(folder)}")
        return
    store = CredentialStore(folder)
    if host:
        raise CredentialError(f"--host: the simulator's certificate in {folder} is made; give it with a new folder")
    if wanted:
        added = store.add(wanted, days=days)
        if not added:
            raise CredentialError(f"{', '.join(wanted)}: have one already; --rotate NAME makes one anew")
        print(f"{folder}: credentials for {', '.join(added)}; {_then(folder)}")
    elif revoke is not None:
        store.revoke(revoke)
        print(f"{revoke} is revoked; {_then(folder)}")
    elif rotate is not None:
        store.rotate(rotate, days=days)
        print(f"{folder / rotate} is new: copy it to where {rotate} runs; {_then(folder)}")
    elif router_config is not None:
        if run is None:
            raise CredentialError("--router-config: the rules are those of one run; give its name with --run")
        print("written: " + ", ".join(str(file) for file in write_router_file(store, router_config, run, listen)))
    else:
        _print(store.entries())


def _check_goes_together(options: Mapping[str, tuple[bool, bool]]) -> None:
    """Raises :class:`CredentialError` for an option that is given (first) where it means nothing (not second)."""
    if idle := [name for name, (given, means_something) in options.items() if given and not means_something]:
        raise CredentialError(f"{', '.join(idle)}: means nothing beside what is asked for; leave it out")


def router(config: Annotated[Path, typer.Option(help="Made by `palanquin credentials DIR --router-config`.")]) -> None:
    """Stand between simulator and agents, and let through what the rules allow, until a signal comes."""
    from deploy.guard import Interrupted
    from wire.zenoh_link import open_router

    with open_router(config):
        print(f"router of {config}", flush=True)
        try:
            threading.Event().wait()
        except Interrupted:
            return


def _how_to(folder: Path) -> str:
    return f"copy {folder}/NAME to the machine of NAME, keep {folder}/ca at home"


def _then(folder: Path) -> str:
    return f"copy {folder}/sim to the simulator's machine and start it anew: it reads {folder}/sim at its start"


def _print(entries: Sequence[Entry]) -> None:
    now = datetime.now(UTC)
    width = max(len(entry.name) for entry in entries)
    for entry in entries:
        state = "revoked" if entry.revoked else "expired" if entry.until <= now else "good"
        print(f"{entry.name:{width}}  {state:7}  until {entry.until:%Y-%m-%d %H:%M} UTC  SHA-256 {entry.fingerprint}")
