"""Files that nobody else may read: 0600 in folders of 0700 from the first moment, and never half-written."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from wire.errors import CredentialError


def write_private(path: Path, text: str) -> None:
    """Write a file of mode 0600, whole or not at all; an older one of that name is replaced.

    Raises:
        CredentialError: it cannot be written.
    """
    new = path.with_name(f".{path.name}.{secrets.token_hex(6)}")
    try:
        descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            os.fchmod(file.fileno(), 0o600)  # a umask may have taken bits away
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except OSError as error:
        raise CredentialError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
    finally:
        with suppress(OSError):
            new.unlink(missing_ok=True)  # it is not there any more if all went well


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A folder of mode 0700 to fill, which takes its name only when the block ends well.

    An older folder of that name is replaced. Raises :class:`CredentialError` where no folder can be made.
    """
    if path.name in ("", ".."):
        raise CredentialError(f"{path}: names no folder of its own; expected a name such as {path / 'team'}")
    building = path.with_name(f".{path.name}.{secrets.token_hex(6)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        building.mkdir(mode=0o700)
    except OSError as error:
        raise CredentialError(f"{path}: cannot be made ({error.strerror}); choose another folder") from None
    try:
        yield building
        old = path.with_name(f".{path.name}.old.{secrets.token_hex(6)}")
        if path.exists():
            path.rename(old)
        building.rename(path)
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(building, ignore_errors=True)


def read_private(path: Path, what: str = "a file of a credential") -> str:
    """The text of a file that only its owner may read; ``what`` it should be is told if there is none.

    Raises:
        CredentialError: it is not there, or others may read it.
    """
    try:
        with path.open(encoding="utf-8") as file:
            mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
            if mode & 0o077:
                raise CredentialError(
                    f"{path}: others may read it (mode {mode:04o}); expected 0600. Make a new credential if somebody "
                    f"did, or else: chmod 600 {path}"
                )
            return file.read()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not text"
        raise CredentialError(f"{path}: cannot be read ({why}); expected {what}") from None
