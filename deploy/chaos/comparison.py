"""The same attack on an open system and on a protected one, and the protected run without it: three measured runs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from deploy.chaos.intruder import ATTEMPTS, Row
from deploy.chaos.staged import Staged, Tell
from deploy.credential_store import CredentialStore
from deploy.settings import scenario_changes
from sim_server.run_folder import TRACE, compute_metrics, read_audit, read_run
from sim_server.scenario_files import load_scenario
from wire.zenoh_link import free_endpoint

SCENARIO = "transport"
LONG_S = 600.0
"""Longer than any attack: the run is stopped when that is over, and the run without it gets as many ticks."""
LOAD_PER_ARM_KG = 4.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """What came of it."""

    protection: str
    arms: int
    here: Sequence[Row]
    open: Sequence[Row]
    """Empty if the open system was left out."""
    same_trace: bool | None
    """Whether the attacked run's trace is that of the run without an intruder, byte for byte; None: not compared."""
    ticks: int
    audit: str
    """The verdict of the attacked run's audit."""
    expect: str = ""
    """The attacked run's bounds that must hold at every moment, each with its value and verdict."""


def compare(folder: Path, say: Callable[[str], None], *, arms: int, tls: bool, only_protected: bool) -> Comparison:
    """Attack, and measure. Each run leaves its folder below ``folder``.

    Raises:
        StageFailed: a run did not come about.
        RunFolderError: the folder is in use.
    """
    protection = "certificates (mTLS)" if tls else "passwords"
    with tempfile.TemporaryDirectory(prefix="palanquin-") as private:
        names = [f"a{number + 1}" for number in range(arms)]
        store = CredentialStore.create(Path(private) / "team", names, days=1, hosts=[])
        opened = [] if only_protected else _attacked(folder / "open", arms, False, None, say, "open system")
        here = _attacked(folder / "here", arms, tls, store, say, f"protected by {protection}")
        ticks = int(read_run(folder / "here")["ended"]["ticks"])
        same = None
        if not only_protected:
            say(f"the same without an intruder: {ticks} ticks")
            _in_peace(folder / "alone", arms, tls, store, load_scenario(SCENARIO).scenario.seconds(ticks))
            same = (folder / "here" / TRACE).read_bytes() == (folder / "alone" / TRACE).read_bytes()
    audit = str(read_audit(folder / "here")["verdict"])
    return Comparison(protection, arms, here, opened, same, ticks, audit, _bounds(folder / "here"))


def _bounds(folder: Path) -> str:
    """What can be judged of a run that was stopped: its largest values so far. The goal is not reached yet."""
    _, judged = compute_metrics(folder)
    return ", ".join(
        f"{row.metric} {'unknown' if row.value is None else f'{row.value:.3g}'} ({row.expected}) {row.verdict}"
        for row in judged
        if "_max_" in row.metric
    )


def _attacked(
    folder: Path, arms: int, tls: bool, store: CredentialStore | None, say: Callable[[str], None], what: str
) -> list[Row]:
    tell: Tell = lambda text: say(f"{what}, {len(ATTEMPTS)} attempts, {text}")  # noqa: E731
    stage = _stage(folder, arms, tls, store, LONG_S)
    try:
        stage.start()
        return stage.attack(tell)
    finally:
        stage.end_all()


def _in_peace(folder: Path, arms: int, tls: bool, store: CredentialStore, duration_s: float) -> None:
    """The same run in peace, for so long."""
    stage = _stage(folder, arms, tls, store, duration_s)
    try:
        stage.start()
        stage.wait_for_the_end()
    finally:
        stage.end_all()


def _stage(folder: Path, arms: int, tls: bool, store: CredentialStore | None, duration_s: float) -> Staged:
    changes = [f"team.count={arms}", f"load.mass_kg={LOAD_PER_ARM_KG * arms}", f"duration_s={duration_s!r}"]
    named = load_scenario(SCENARIO, scenario_changes(None, changes))
    arguments = [word for change in changes for word in ("--set", change)]
    endpoint = free_endpoint().replace("tcp/", "tls/") if tls else free_endpoint()
    return Staged([*arguments, "--", SCENARIO], named.scenario, endpoint, folder, store)
