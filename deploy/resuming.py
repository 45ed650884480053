"""``palanquin sim --resume RUN``: the checkpoint, and whether the rest of the command line means the same run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim_server.checkpoint_file import Checkpoint, CheckpointError, read_checkpoint
from sim_server.scenario_files import load_scenario


def checkpoint_to_resume(
    folder: Path | None, scenario: str | None, changes: Mapping[str, Any], run: str | None, out: Path | None
) -> Checkpoint | None:
    """The checkpoint in ``folder``; None if there is nothing to resume. A scenario and the name of a run may be given
    too, but must be the same.

    Raises:
        CheckpointError: no checkpoint that can be used, or the other options mean another run.
        ScenarioError: the scenario that was given cannot be used.
    """
    if folder is None:
        return None
    if out is not None:
        raise CheckpointError(f"--resume {folder} goes on in that folder: got --out {out}; leave it out")
    checkpoint = read_checkpoint(folder)
    if run is not None and run != checkpoint.run:
        raise CheckpointError(
            f"--resume {folder}: got --run {run}, expected {checkpoint.run}, with which the run began; leave it out"
        )
    if changes and scenario is None:
        raise CheckpointError(
            f"--resume {folder}: got --seed or --set, expected neither: the scenario is the one that the run began with"
        )
    if scenario is not None:
        given = load_scenario(scenario, changes).scenario.model_dump(mode="json")
        began = checkpoint.named.scenario.model_dump(mode="json")
        if difference := first_difference(began, given):
            key, before, now = difference
            raise CheckpointError(
                f"--resume {folder}: the scenario has changed: {key}: got {now!r}, expected {before!r}, which the run "
                "began with; leave SCENARIO out to go on with that"
            )
    return checkpoint


def first_difference(before: Any, now: Any, key: str = "") -> tuple[str, Any, Any] | None:
    """The first place where two trees of plain values differ, as (dotted key, before, now); None if they are equal."""
    if isinstance(before, dict) and isinstance(now, dict):
        for name in [*before, *(name for name in now if name not in before)]:
            found = first_difference(before.get(name), now.get(name), f"{key}.{name}" if key else str(name))
            if found:
                return found
        return None
    return None if before == now else (key, before, now)
