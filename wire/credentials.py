"""What proves who a process is: a password on one machine, a certificate between machines. Reading and writing only.

A credential is a folder that can be copied to the machine of its process: ``credential.json`` (who, password), and
``authority.pem``, ``certificate.pem``, ``key.pem``. The simulator's has ``guests.json`` as well: everybody whom it
lets in. On one machine the launcher makes both in memory and hands them over as one line of text, without any file.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from wire.access import Principal, Role, principal
from wire.errors import CredentialError, Refused
from wire.private_files import read_private, write_private

CREDENTIAL, GUESTS = "credential.json", "guests.json"
AUTHORITY, CERTIFICATE, KEY = "authority.pem", "certificate.pem", "key.pem"
STDIN = "-"
"""Instead of a folder: one line of standard input."""
MAX_LINE = 60_000


@dataclass(frozen=True, slots=True)
class Certificate:
    """PEM texts: the authority that the other side's certificate must come from, and one's own with its key."""

    authority: str
    certificate: str
    key: str = field(repr=False)


@dataclass(frozen=True, slots=True)
class Credential:
    """One process's proof of who it is."""

    who: Principal
    password: str = field(repr=False)
    expires: datetime | None = None
    """None: it lives and dies with the run."""
    certificate: Certificate | None = field(default=None, repr=False)

    def expired(self, now: datetime) -> bool:
        """Whether it is of no use any more."""
        return self.expires is not None and self.expires <= now

    def check(self, wanted: Principal, now: datetime) -> None:
        """Raises :class:`CredentialError` unless this is the credential of ``wanted``, of whichever login, in time."""
        if (self.who.name, self.who.role) != (wanted.name, wanted.role):
            raise CredentialError(
                f"this credential is for {self.who.name}, not for {wanted.name}: give the folder of {wanted.name} "
                "with --credential"
            )
        if self.expired(now):
            raise CredentialError(
                f"the credential of {self.who.name} expired at {self.expires:%Y-%m-%d %H:%M} UTC: make a new one "
                f"with `palanquin credentials DIR --rotate {self.who.name}`"
            )

    def as_fields(self) -> dict[str, Any]:
        """Everything but the certificate, for JSON."""
        return {
            "v": 1,
            "name": self.who.name,
            "role": str(self.who.role),
            "login": self.who.login,
            "password": self.password,
            "expires": self.expires.isoformat() if self.expires is not None else None,
        }


@dataclass(frozen=True, slots=True)
class Guests:
    """What the simulator (or a router) needs: its own credential, and the credentials of those whom it lets in."""

    own: Credential
    admitted: tuple[Credential, ...]

    def of(self, name: str) -> Credential:
        """The credential of ``name``."""
        return next(guest for guest in self.admitted if guest.who.name == name)

    def in_time(self, now: datetime) -> tuple[Credential, ...]:
        """Those who have not expired."""
        return tuple(guest for guest in self.admitted if not guest.expired(now))


def new_password() -> str:
    """192 random bits."""
    return secrets.token_urlsafe(24)


def for_one_run(names: Iterable[str]) -> Guests:
    """Passwords made on the fly, for the processes of one run on one machine. Raises :class:`Refused` for a bad
    name."""
    return Guests(
        Credential(principal(Role.SIM), new_password()),
        tuple(Credential(principal(name), new_password()) for name in names),
    )


def write_credential(folder: Path, credential: Credential) -> None:
    """Fill a folder, which exists and is private."""
    write_private(folder / CREDENTIAL, json.dumps(credential.as_fields(), indent=1) + "\n")
    if credential.certificate is not None:
        write_private(folder / AUTHORITY, credential.certificate.authority)
        write_private(folder / CERTIFICATE, credential.certificate.certificate)
        write_private(folder / KEY, credential.certificate.key)


def write_guests(folder: Path, admitted: Iterable[Credential]) -> None:
    """Say in the simulator's folder whom it lets in."""
    write_private(folder / GUESTS, json.dumps([guest.as_fields() for guest in admitted], indent=1) + "\n")


def read_credential(place: str | Path) -> Credential:
    """The credential in a folder, or in the next line of standard input for ``-``.

    Raises:
        CredentialError: there is none, it is not one, or others may read it.
    """
    if str(place) == STDIN:
        return _credential("standard input", _line_of_stdin())
    folder = _folder(Path(place))
    return _with_certificate(folder, _credential(str(folder / CREDENTIAL), _json(folder / CREDENTIAL)))


def read_guests(place: str | Path) -> Guests:
    """The simulator's credential and everybody whom it lets in. Raises :class:`CredentialError` as
    :func:`read_credential` does."""
    if str(place) == STDIN:
        whole = _line_of_stdin()
        if not isinstance(whole, dict) or whole.keys() != {"own", "guests"}:
            raise CredentialError("standard input: expected a map of `own` and `guests`")
        return Guests(_credential("standard input", whole["own"]), _admitted("standard input", whole["guests"]))
    folder = _folder(Path(place))
    if not (folder / GUESTS).exists():
        raise CredentialError(
            f"{folder}: the credential of an agent; expected the simulator's, which says whom it lets in ({GUESTS})"
        )
    return Guests(read_credential(folder), _admitted(str(folder / GUESTS), _json(folder / GUESTS)))


def credential_line(credential: Credential) -> bytes:
    """What ``--credential -`` reads."""
    return json.dumps(credential.as_fields()).encode() + b"\n"


def guests_line(guests: Guests) -> bytes:
    """What ``sim --credentials -`` reads."""
    fields = {"own": guests.own.as_fields(), "guests": [guest.as_fields() for guest in guests.admitted]}
    return json.dumps(fields).encode() + b"\n"


def check_for(credential: Credential | None, name: str) -> None:
    """Raises :class:`CredentialError` if this is the credential of somebody else, or of no use any more."""
    if credential is not None:
        credential.check(principal(name), datetime.now(UTC))


def _folder(folder: Path) -> Path:
    if not (folder / CREDENTIAL).is_file():
        inside = sorted(found.parent.name for found in folder.glob(f"*/{CREDENTIAL}"))
        hint = f"one of the folders in it: {', '.join(inside)}" if inside else "one made by `palanquin credentials`"
        raise CredentialError(f"{folder}: no credential ({CREDENTIAL} is not there); expected {hint}")
    return folder


def _with_certificate(folder: Path, credential: Credential) -> Credential:
    if not (folder / KEY).exists():
        return credential
    certificate = Certificate(*(read_private(folder / name) for name in (AUTHORITY, CERTIFICATE, KEY)))
    return replace(credential, certificate=certificate)


def _json(path: Path) -> Any:
    try:
        return json.loads(read_private(path))
    except ValueError as error:
        raise CredentialError(f"{path}: not JSON ({error})") from None


def _line_of_stdin() -> Any:
    """One line, byte by byte: what follows it is not ours to take."""
    line = bytearray()
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        line += byte
        if not byte or len(line) > MAX_LINE:
            raise CredentialError(f"standard input: {len(line)} bytes without an end of line; expected a credential")
    try:
        return json.loads(line)
    except ValueError as error:
        raise CredentialError(f"standard input: not JSON ({error})") from None


def _admitted(where: str, guests: Any) -> tuple[Credential, ...]:
    if not isinstance(guests, list):
        raise CredentialError(f"{where}: expected a list of credentials")
    return tuple(_credential(where, each) for each in guests)


def _credential(where: str, fields: Any) -> Credential:
    try:
        if fields["v"] != 1:
            raise CredentialError(f"{where}: version {fields['v']!r}, expected 1: install the same release everywhere")
        who = Principal(str(fields["name"]), Role(fields["role"]), str(fields["login"]))
        expires = fields["expires"] and datetime.fromisoformat(fields["expires"]).astimezone(UTC)
        return Credential(who, str(fields["password"]), expires or None)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CredentialError(f"{where}: not a credential ({type(error).__name__}: {error})") from None
    except Refused as error:
        raise CredentialError(f"{where}: {error}") from None
