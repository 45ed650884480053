"""Which link a verb opens, with which credential, and when it would rather not."""

from __future__ import annotations

from wire.credentials import Credential, check_for, read_credential, read_guests
from wire.errors import CredentialError
from wire.zenoh_link import ZenohLink, open_client, open_server

OPEN_MEANS = "no access rules: anyone who can reach this address may listen and command"


def open_sim_link(
    run: str, listen: str, router: str | None, credentials: str | None, *, is_open: bool, insecure_network: bool
) -> ZenohLink:
    """The simulator's link: it listens itself, or is a client of a router.

    Raises:
        CredentialError: neither credentials nor the word that it shall do without, or both, or bad ones.
        LinkError: as :func:`open_server` and :func:`open_client`.
    """
    if credentials is None and not is_open:
        raise CredentialError(
            "who may connect? Make credentials with `palanquin credentials DIR --arms 4` and give --credentials "
            f"DIR/sim, or say --open ({OPEN_MEANS})"
        )
    if credentials is not None and is_open:
        raise CredentialError("--credentials and --open exclude each other: rules, or none")
    guests = None if credentials is None else read_guests(credentials)
    if guests is not None:
        check_for(guests.own, "sim")
    if router is not None:
        return open_client(router, None if guests is None else guests.own)
    return open_server(listen, guests, run, insecure_network=insecure_network)


def own_credential(place: str | None, name: str) -> Credential | None:
    """An agent's credential, if it is given one. Whose it is can be told before anybody is asked.

    Raises:
        CredentialError: bad, too old, or somebody else's.
    """
    own = None if place is None else read_credential(place)
    check_for(own, name)
    return own
