"""``palanquin verify``: a sample of a report's runs, run again, against what the report says of them."""

from __future__ import annotations

import hashlib
import json
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.batch import BatchError, run_one
from deploy.exit_status import BAD_INPUT
from deploy.paper.plan import PRESETS, Preset
from deploy.planned_run import Run
from sim_server.errors import SimError
from sim_server.metrics import METRICS as NUMBERS
from sim_server.run_folder import METRICS

REPORT = "paper.json"
"""What a report rests on, and is checked by."""
WALL_TIME = ("real_time_factor", "wall_s", "missed_percent", "slowed_s")
"""Metrics that no two runs share."""
OTHER_VERSIONS = 1e-3
"""Relative: what other versions of MuJoCo or numpy may change, or one part in a thousand of the metric's own unit."""


class ReportError(SimError):
    """A report cannot be read."""

    exit_status = BAD_INPUT


@dataclass(frozen=True, slots=True)
class Difference:
    """One number that came out otherwise."""

    run: str
    metric: str
    reported: Any
    found: Any


def read_report(path: Path) -> dict[str, Any]:
    """The content of a paper.json, given as file or as its folder.

    Raises:
        ReportError: it is none.
    """
    file = path / REPORT if path.is_dir() else path
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        runs = [(entry["name"], entry["metrics"]["verdict"], run_of(entry).resolved()) for entry in content["runs"]]
        for claim in content["claims"]:
            _ = [claim[key] for key in ("name", "law", "verdict", "bound")], dict(values_of(claim))
        content["versions"].items()
    except FileNotFoundError:
        raise ReportError(f"{file}: no such file: expected a {REPORT} of `palanquin paper`, or its folder") from None
    except (OSError, ValueError, LookupError, TypeError, AttributeError, SimError) as error:
        raise ReportError(f"{file} is no report of `palanquin paper`: {type(error).__name__}: {error}") from None
    if not runs:
        raise ReportError(f"{file}: a report without runs: there is nothing to verify")
    return dict(content)


def values_of(claim: Mapping[str, Any]) -> list[tuple[int, float]]:
    """Seed and value of each. Raises ``ValueError`` if they do not match."""
    return list(zip(claim["seeds"], claim["values"], strict=True))


def spoiled(report: Mapping[str, Any]) -> list[str]:
    """Entries whose digests are not those of the run that they name and of the metrics that they give."""
    return [
        str(entry["name"])
        for entry in report["runs"]
        if (entry.get("digest"), entry.get("metrics_sha256")) != (run_of(entry).digest, sha256_of(entry["metrics"]))
    ]


def sha256_of(content: Mapping[str, Any]) -> str:
    """SHA-256 (hex) of the content as JSON."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def run_of(entry: Mapping[str, Any]) -> Run:
    """The run that an entry of a report names."""
    return Run(
        str(entry["group"]),
        str(entry["condition"]),
        _law(entry["law"]),
        str(entry["scenario"]),
        dict(entry["changes"]),
        int(entry["seed"]),
    )


def _law(name: object) -> Preset:
    for law in PRESETS:
        if law == name:
            return law
    raise ValueError(f"law {name!r}: expected one of {', '.join(PRESETS)}")


def sample(report: Mapping[str, Any], count: int, seed: int) -> list[Mapping[str, Any]]:
    """So many of its entries, drawn from the seed."""
    entries: Sequence[Mapping[str, Any]] = report["runs"]
    return random.Random(seed).sample(entries, min(count, len(entries)))


def run_again(entry: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """Its metrics now.

    Raises:
        BatchError: it could not be run.
    """
    problem = run_one(run_of(entry), str(folder))
    if problem:
        raise BatchError(f"{entry['name']} could not be run again: {problem}")
    found: Mapping[str, Any] = json.loads((folder / METRICS).read_text(encoding="utf-8"))
    return found


def physical(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """What every run of the same thing shares: all but wall times; and the verdict."""
    return {name: metrics.get(name) for name in (*NUMBERS, "verdict") if name not in WALL_TIME}


def differences(entry: Mapping[str, Any], found: Mapping[str, Any], *, exact: bool) -> list[Difference]:
    """The physical metrics that are not what the report says.

    Args:
        exact: with the same versions every bit has to be the same.
    """
    out = []
    for metric, now in physical(found).items():
        reported = entry["metrics"].get(metric)
        if reported == now:
            continue
        if exact or not close(reported, now):
            out.append(Difference(entry["name"], metric, reported, now))
    return out


def close(a: Any, b: Any) -> bool:
    """Whether other versions explain the difference."""
    if not isinstance(a, int | float) or not isinstance(b, int | float):
        return False
    return abs(a - b) <= OTHER_VERSIONS * max(1.0, abs(a), abs(b))
