"""A run's checkpoint as a file: written whole or not at all, checked when it is read, never run as code.

``RUN/checkpoint/<tick>.state`` is a line ``palanquin checkpoint <version> <SHA-256 of the rest>``, then a snapshot.
Each has a name of its own, since a file system may write the new one to the disk before it lets go of an old one of
that name, and that takes up to tens of milliseconds (ext4).
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from sim_server.errors import SimError
from sim_server.run_folder import RUN, read_run
from sim_server.scenario import Scenario
from sim_server.scenario_files import NamedScenario
from sim_server.snapshot import Snapshot, unpack
from wire.errors import Refused

FOLDER, STATE = "checkpoint", ".state"
VERSION = 5
"""Of what is in it; any change of a ``state()`` raises it."""
HEAD = "palanquin checkpoint"
MUST_BE_EQUAL = ("palanquin", "mujoco")
"""Packages whose other version would not go on with the same numbers."""


class CheckpointError(SimError):
    """A run cannot go on from what is in its folder. Nothing in there has been changed."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """Where a run stood, and what run it is."""

    folder: Path
    run: str
    named: NamedScenario
    content: Snapshot

    @contextmanager
    def taking_back(self) -> Iterator[None]:
        """Whatever does not fit while the content is taken back means the same."""
        try:
            yield
        except (LookupError, TypeError, ValueError, AttributeError, OSError, Refused) as error:
            raise CheckpointError(_spoiled(self.folder, f"{type(error).__name__}: {error}")) from error


def versions() -> dict[str, str]:
    """Versions of the packages that must be the same."""
    return {name: importlib.metadata.version(name) for name in MUST_BE_EQUAL}


def checkpoint_path(folder: Path, tick: int) -> Path:
    """The file of a checkpoint in a run folder."""
    return folder / FOLDER / f"{tick:010}{STATE}"


def write_checkpoint(file: Path, body: bytes, before: Path | None) -> None:
    """Put a checkpoint, a packed snapshot, in the place of the one ``before``. A process that is killed leaves one or
    both."""
    part = file.with_suffix(".part")
    part.write_bytes(f"{HEAD} {VERSION} {hashlib.sha256(body).hexdigest()}\n".encode() + body)
    os.replace(part, file)
    if before is not None and before != file:
        before.unlink(missing_ok=True)


def last_checkpoint(folder: Path) -> Path | None:
    """The file of the last checkpoint in a run folder."""
    return max((folder / FOLDER).glob(f"*{STATE}"), default=None)


def read_checkpoint(folder: Path) -> Checkpoint:
    """The last checkpoint of the run in this folder.

    Raises:
        CheckpointError: no such run, one that has ended, or that has no checkpoint, or one that cannot be used.
    """
    if not folder.is_dir():
        raise CheckpointError(
            f"--resume {folder}: no such folder; expected the run folder of a simulator that was killed"
        )
    if (folder / RUN).exists():
        ended = read_run(folder).get("ended")
        why = ended.get("why", "") if isinstance(ended, dict) else ""
        raise CheckpointError(
            f"--resume {folder}: this run has ended in order ({why}): there is nothing to go on with; start it anew"
        )
    file = last_checkpoint(folder)
    if file is None:
        raise CheckpointError(
            f"--resume {folder}: no checkpoint in it: expected {FOLDER}/<tick>{STATE}, which a simulator writes at its "
            "first tick and then every record.checkpoint_s of simulated time (0: never); start the run anew"
        )
    try:
        data = file.read_bytes()
    except OSError as error:
        raise CheckpointError(f"--resume {folder}: {file} cannot be read: {error.strerror}") from None
    return _checked(folder, *_head_and_body(folder, data))


def _head_and_body(folder: Path, data: bytes) -> tuple[str, str, bytes]:
    head, _, body = data.partition(b"\n")
    words = head.decode("ascii", "replace").rsplit(" ", 2)
    if len(words) != 3 or words[0] != HEAD:
        raise CheckpointError(_spoiled(folder, f"begins with {data[:30]!r}, expected {HEAD!r}"))
    return words[1], words[2], body


def _checked(folder: Path, version: str, digest: str, body: bytes) -> Checkpoint:
    if version != str(VERSION):
        raise CheckpointError(
            f"--resume {folder}: the checkpoint has version {version}, expected {VERSION}: go on with the release of "
            "Palanquin that began the run"
        )
    if hashlib.sha256(body).hexdigest() != digest:
        raise CheckpointError(_spoiled(folder, f"its {len(body)} bytes do not have the checksum that it names"))
    try:
        content = unpack(body)
        theirs = {name: str(content["versions"][name]) for name in MUST_BE_EQUAL}
        for name, ours in versions().items():
            if theirs[name] != ours:
                raise CheckpointError(
                    f"--resume {folder}: the run began with {name} {theirs[name]}, here is {ours}, which would go on "
                    f"with other numbers: install {name} {theirs[name]}"
                )
        scenario = Scenario.model_validate(content["scenario"])
        named = NamedScenario(str(content["scenario_name"]), str(content["scenario_source"]), scenario)
        return Checkpoint(folder, str(content["run"]), named, content)
    except (LookupError, TypeError, ValueError, ValidationError) as error:
        raise CheckpointError(_spoiled(folder, f"{type(error).__name__}: {error}")) from None


def _spoiled(folder: Path, problem: str) -> str:
    return (
        f"--resume {folder}: the last checkpoint in {FOLDER}/ is spoiled or of another program "
        f"({' '.join(problem.split())}): the run cannot go on from it; start it anew"
    )
