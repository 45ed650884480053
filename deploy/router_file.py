"""The configuration of a router that stands between simulator and agents, for ``palanquin router`` or a `zenohd`."""

from __future__ import annotations

import json
from pathlib import Path

from deploy.credential_store import CredentialStore
from wire.access import Role
from wire.credentials import Guests
from wire.endpoints import check_stays_here_or_is_proven, parse_endpoint
from wire.errors import CredentialError
from wire.private_files import write_private
from wire.zenoh_config import passwords, server_config

HEAD = """\
// Router between simulator and agents of the run {run!r}. Made by `palanquin credentials --router-config`: make it anew
// after every --revoke, --rotate or new arm. Keep it private, and {passwords} beside it: they hold the
// router's key, if it has one, and the passwords.
"""


def write_router_file(store: CredentialStore, file: Path, run: str, listen: str) -> list[Path]:
    """Write the configuration, and a second file with the passwords beside it. Returns what was written.

    Raises:
        CredentialError: the file cannot be written.
        LinkError: other machines could reach the address, and it does not ask for certificates.
        Refused: the run's name cannot be part of a key.
    """
    check_stays_here_or_is_proven(parse_endpoint(listen), has_credentials=True)
    guests = Guests(store.credential(Role.ROUTER), (store.credential(Role.SIM), *store.admitted()))
    file = file.absolute()
    secret = file.with_name(file.name + ".passwords")
    config = server_config(listen, guests, run, str(secret))
    text = HEAD.format(run=run, passwords=secret.name) + json.dumps(config, indent=2) + "\n"
    if file.is_dir():
        raise CredentialError(f"--router-config {file}: is a folder; expected the file to write")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CredentialError(f"--router-config {file}: cannot be written ({error.strerror}); choose another") from None
    write_private(secret, passwords(guests))  # first: the other one names it
    write_private(file, text)
    return [file, secret]
