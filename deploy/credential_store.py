"""All credentials of a team, kept at home: ``ca/`` (the authority and the register) and a folder for each process.

The register is the truth; what the simulator and the router read of it is written anew after every change. Nobody who
is not in it is let in, so that a revoked certificate is useless though its signature is good.
"""

from __future__ import annotations

import ipaddress
import json
import re
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from deploy.authority import HERE, fingerprint, issue, new_authority
from wire.access import Role, principal
from wire.credentials import Credential, new_password, read_credential, write_credential, write_guests
from wire.errors import CredentialError
from wire.private_files import new_folder, read_private, write_private

CA, REGISTER, CA_CERTIFICATE, CA_KEY = "ca", "register.json", "authority.pem", "authority.key"
SERVERS = (str(Role.SIM), str(Role.ROUTER))
OTHERS = (str(Role.LEADER), str(Role.OBSERVER), str(Role.OPERATOR))
MAX_DAYS = 3650


@dataclass(frozen=True, slots=True)
class Entry:
    """One process's line in the register."""

    name: str
    generation: int
    password: str = field(repr=False)
    fingerprint: str
    expires: str
    revoked: bool = False

    @property
    def until(self) -> datetime:
        return datetime.fromisoformat(self.expires)

    def credential(self) -> Credential:
        """What the simulator has to know of it."""
        return Credential(principal(self.name, self.generation), self.password, self.until)


_HOST_NAME = re.compile(r"(?=.{1,253}\Z)[A-Za-z0-9_]([A-Za-z0-9_-]{0,62})(\.[A-Za-z0-9_][A-Za-z0-9_-]{0,62})*")


def _check_host(host: str) -> None:
    """Raises :class:`CredentialError` for what a certificate cannot name."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        if not _HOST_NAME.fullmatch(host):
            raise CredentialError(
                f"--host {host!r}: expected an IP address or a host name in ASCII, such as sim.example; write others "
                "in their xn-- form"
            ) from None


class CredentialStore:
    """The folder of all credentials.

    Args:
        folder: as made by :meth:`create`.

    Raises:
        CredentialError: it is none.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not self.is_one(folder):
            raise CredentialError(
                f"{folder}: no credentials here; make them with `palanquin credentials {folder} --arms 4`"
            )
        try:
            register: dict[str, Any] = json.loads(read_private(folder / CA / REGISTER))
            self._hosts = tuple(register["hosts"])
            self._entries = {fields["name"]: Entry(**fields) for fields in register["entries"]}
        except (ValueError, KeyError, TypeError) as error:
            raise CredentialError(f"{folder / CA / REGISTER}: not a register ({error})") from None

    @staticmethod
    def is_one(folder: Path) -> bool:
        """Whether there is a register."""
        return (folder / CA / REGISTER).is_file()

    @classmethod
    def create(
        cls, folder: Path, arms: Sequence[str], *, days: int, hosts: Sequence[str], now: datetime | None = None
    ) -> CredentialStore:
        """Make an authority and a credential for everybody. The folder appears whole or not at all."""
        now = now or datetime.now(UTC)
        for host in hosts:
            _check_host(host)
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise CredentialError(f"{folder}: is there and holds no credentials of ours; choose another folder")
        with new_folder(folder) as building:
            (building / CA).mkdir(mode=0o700)
            certificate, key = new_authority(now)
            write_private(building / CA / CA_CERTIFICATE, certificate)
            write_private(building / CA / CA_KEY, key)
            write_private(building / CA / REGISTER, json.dumps({"hosts": list(hosts), "entries": []}))
            cls(building).add((*SERVERS, *OTHERS, *arms), days=days, now=now)
        return cls(folder)

    def add(self, names: Iterable[str], *, days: int, now: datetime | None = None) -> list[str]:
        """Make credentials for those of ``names`` who have none, and return whom that was."""
        new = [name for name in dict.fromkeys(names) if name not in self._entries]
        for name in new:
            principal(name)  # every name is good before the first file is written
            if name == CA:  # its folder would take the place of the authority's, and the key that signs be gone
                raise CredentialError(
                    f"--arm {name}: the authority's folder has this name; call the arm something else"
                )
        for name in new:
            self._issue(name, 1, days, now)
        self._write()
        return new

    def rotate(self, name: str, *, days: int, now: datetime | None = None) -> None:
        """Make a credential anew, under a new login: the old one is let in no more. A revoked one comes back."""
        self._issue(name, self._entry(name).generation + 1, days, now)
        self._write()

    def revoke(self, name: str) -> None:
        """Let a credential in no more."""
        if name in SERVERS:
            raise CredentialError(
                f"{name} asks for credentials and is not asked by itself: revoking it would lock nobody out. "
                f"--rotate {name} makes a new one; if its key is stolen, make all credentials anew"
            )
        if self._entry(name).revoked:
            raise CredentialError(f"{name}: is revoked already; --rotate {name} makes a new one")
        self._entries[name] = replace(self._entry(name), revoked=True)
        self._write()
        shutil.rmtree(self.folder / name, ignore_errors=True)

    def entries(self) -> list[Entry]:
        """Everybody, servers first."""
        return list(self._entries.values())

    def credential(self, name: str) -> Credential:
        """The credential of ``name``, with its certificate."""
        return read_credential(self.folder / self._entry(name).name)

    def admitted(self) -> tuple[Credential, ...]:
        """Whom the simulator lets in."""
        return tuple(
            entry.credential() for entry in self._entries.values() if not entry.revoked and entry.name not in SERVERS
        )

    def _entry(self, name: str) -> Entry:
        if name not in self._entries:
            raise CredentialError(f"{name}: has no credential here; expected one of {', '.join(self._entries)}")
        return self._entries[name]

    def _issue(self, name: str, generation: int, days: int, now: datetime | None) -> None:
        now = now or datetime.now(UTC)
        if not 1 <= days <= MAX_DAYS:
            raise CredentialError(f"--days {days}: expected 1 to {MAX_DAYS}")
        expires = (now + timedelta(days=days)).replace(microsecond=0)
        who = principal(name, generation)
        certificate = issue(
            read_private(self.folder / CA / CA_CERTIFICATE),
            read_private(self.folder / CA / CA_KEY),
            who.login,
            now,
            expires,
            (*HERE, *self._hosts) if name in SERVERS else (),
        )
        credential = Credential(who, new_password(), expires, certificate)
        with new_folder(self.folder / name) as building:
            write_credential(building, credential)
            if name == Role.SIM:
                write_guests(building, self.admitted())
        self._entries[name] = Entry(
            name, generation, credential.password, fingerprint(certificate.certificate), expires.isoformat()
        )

    def _write(self) -> None:
        register = {"hosts": list(self._hosts), "entries": [asdict(entry) for entry in self._entries.values()]}
        write_private(self.folder / CA / REGISTER, json.dumps(register, indent=1) + "\n")
        write_guests(self.folder / Role.SIM, self.admitted())
