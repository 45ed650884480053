"""Where the runs of a batch are run: on this machine, or on a Ray cluster, whose place a double takes here."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

import deploy.batch
from deploy.batch import LocalEngine, RayEngine, engine_of, run_missing
from deploy.chaos.commands import app
from deploy.planned_run import Run

RUNS = [Run("group", "condition", "paper", "hold", {}, seed, may_lose=True) for seed in (1, 2, 3)]


class Ended:
    """What a cluster gives in place of a result."""

    def __init__(self, result: str) -> None:
        self.result = result


class Cluster:
    """Has what the engine needs of Ray, and runs at once what it is given."""

    def __init__(self) -> None:
        self.address: str | None = ""
        self.cores: list[int] = []

    def init(self, address: str | None, **_: object) -> None:
        self.address = address

    def remote(self, num_cpus: int) -> Callable[[Callable[..., str]], Any]:
        self.cores.append(num_cpus)
        return lambda function: SimpleNamespace(remote=lambda *given: Ended(function(*given)))

    def wait(self, waiting: Sequence[Any], num_returns: int) -> tuple[list[Any], list[Any]]:
        return [*waiting[-num_returns:]], [*waiting[:-num_returns]]

    def get(self, ended: Ended) -> str:
        return ended.result


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Cluster:
    cluster = Cluster()
    monkeypatch.setitem(sys.modules, "ray", cluster)
    return cluster


def no_simulator(run: Run, folder: str) -> str:
    return f"no simulator for {Path(folder).name}"


def test_a_cluster_runs_every_run_in_its_own_folder_and_tells_what_was_in_the_way(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(deploy.batch, "run_one", no_simulator)
    told: list[tuple[int, int]] = []
    engine = engine_of("ray", None, "ray://there:10001")
    assert isinstance(engine, RayEngine)
    problems = run_missing(RUNS, tmp_path, engine, lambda there, total: told.append((there, total)))
    assert problems == {run.place: f"no simulator for {Path(run.place).name}" for run in RUNS}
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert (cluster.address, cluster.cores) == ("ray://there:10001", [1])


def test_without_a_word_it_is_this_machine() -> None:
    assert isinstance(engine_of("local", 2, None), LocalEngine)


@pytest.mark.parametrize(
    "verb", [("matrix", "--only", "kill", "--seeds", "1", "--arms", "4"), ("lost", "--ticks", "2")]
)
def test_the_chaos_verbs_run_on_a_cluster_too(
    verb: tuple[str, ...], cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(deploy.batch, "run_one", no_simulator)
    command = [*verb, "--engine", "ray", "--ray-address", "here", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 3, done.output  # no run could be run, so nothing is known
    assert cluster.address == "here"


def test_without_ray_it_is_said_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(deploy.batch.BatchError, match="pip install"):
        engine_of("ray", None, None)
