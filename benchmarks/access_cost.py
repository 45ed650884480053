"""What silence costs: ``python benchmarks/access_cost.py [PAIRS [SECONDS]]``. Prints, asserts nothing.

Lock-step ticks per second of ``transport`` without rules and walls, and with passwords, with certificates, with walls;
one of each in turn, so that a machine that changes its speed changes all of a round. Then how long it takes until a
bad login is refused.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from deploy.chaos.comparison import SCENARIO
from deploy.chaos.staged import Staged
from deploy.credential_store import CredentialStore
from deploy.settings import scenario_changes
from sim_server.run_folder import read_run
from sim_server.scenario_files import load_scenario
from wire.credentials import Credential, read_guests
from wire.errors import LinkError
from wire.zenoh_link import free_endpoint, open_client, open_server

KINDS = ("open", "passwords, walls", "certificates, walls")
LOGINS = 5


def ticks_per_s(kind: str, store: CredentialStore, seconds: float, folder: Path) -> float:
    """Of one run."""
    change = f"duration_s={seconds!r}"
    named = load_scenario(SCENARIO, scenario_changes(None, [change]))
    endpoint = free_endpoint()
    if kind.startswith("certificates"):
        endpoint = endpoint.replace("tcp/", "tls/")
    arguments = ["--set", change, "--", SCENARIO]
    stage = Staged(arguments, named.scenario, endpoint, folder, None if kind == "open" else store)
    try:
        stage.start()
        stage.wait_for_the_end()
    finally:
        stage.end_all()
    measured = read_run(folder)["measured"]
    return float(measured["real_time_factor"]) / named.scenario.seconds(1)


def refusal_ms(store: CredentialStore, bad: Credential, protocol: str) -> tuple[float, str]:
    """Time until a wrong login is told so, ms, and what it is told."""
    endpoint = free_endpoint().replace("tcp/", f"{protocol}/")
    with open_server(endpoint, read_guests(str(store.folder / "sim")), "carry"):
        open_client(endpoint, store.credential("a1")).close()
        start = time.perf_counter()
        try:
            open_client(endpoint, bad).close()
        except LinkError as refusal:
            return 1e3 * (time.perf_counter() - start), str(refusal)
    return float("nan"), "it was let in"


def main() -> None:
    pairs = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 5.0
    table = Table("round", *(f"{kind}, ticks/s" for kind in KINDS), *(f"{kind} / open" for kind in KINDS[1:]))
    ratios: dict[str, list[float]] = {kind: [] for kind in KINDS[1:]}
    with tempfile.TemporaryDirectory(prefix="palanquin-") as place:
        stores = [
            CredentialStore.create(Path(place) / name, load_scenario(SCENARIO).scenario.arms, days=1, hosts=[])
            for name in ("team", "other")
        ]
        for k in range(pairs):
            found = {kind: ticks_per_s(kind, stores[0], seconds, Path(place) / f"{k}-{kind}") for kind in KINDS}
            for kind, each in ratios.items():
                each.append(found[kind] / found["open"])
            row = [*(f"{found[kind]:.0f}" for kind in KINDS), *(f"{each[-1]:.2f}" for each in ratios.values())]
            table.add_row(str(k + 1), *row)
        table.add_row("median", *[""] * len(KINDS), *(f"{statistics.median(each):.2f}" for each in ratios.values()))
        console = Console()
        console.print(table)
        wrong_password = replace(stores[0].credential("a1"), password="wrong")
        foreign = stores[1].credential("a1")
        for protocol, bad in (("tcp", wrong_password), ("tls", wrong_password), ("tls", foreign)):
            times = [refusal_ms(stores[0], bad, protocol) for _ in range(LOGINS)]
            median = statistics.median(time_ms for time_ms, _ in times)
            console.print(
                f"a bad login over {protocol} is refused after {median:.0f} ms: {times[0][1]}", soft_wrap=True
            )


if __name__ == "__main__":
    main()
