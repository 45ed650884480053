"""Arm descriptions (MJCF) that the simulator and the agents agree on, and their digests.

Part of the contract: the simulator builds the world's arms from these files, an agent builds its own model from the
same file, and the digest in its hello says whether the two read the same bytes.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

_FOLDER = Path(__file__).parent


class UnknownArm(ValueError):
    """No description of that name comes with the package.

    Attributes:
        name: the name asked for.
        known: the names there are.
        exit_status: what a command line that ends with this error exits with: bad input.
    """

    exit_status = 2

    def __init__(self, name: str, known: tuple[str, ...]) -> None:
        self.name, self.known = name, known
        super().__init__(f"unknown arm {name!r}; expected one of: {', '.join(known)}")


def known_arms() -> tuple[str, ...]:
    """Names of the arms that come with the package, sorted."""
    return tuple(sorted(file.stem for file in _FOLDER.glob("*.xml")))


def arm_path(name: str) -> Path:
    """File with the arm's MJCF. Raises ``UnknownArm``."""
    known = known_arms()
    if name not in known:  # by name, never by path: a name from the wire cannot walk out of the folder
        raise UnknownArm(name, known)
    return _FOLDER / f"{name}.xml"


def arm_digest(name: str) -> str:
    """SHA-256 of the file's bytes, 64 hex digits. Raises ``UnknownArm``."""
    return hashlib.sha256(arm_path(name).read_bytes()).hexdigest()
