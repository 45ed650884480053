"""Many runs, several at a time, each a ``palanquin run`` of its own; what is there already is not run again."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from deploy.exit_status import COULD_NOT_RUN
from deploy.left_over import left_over
from deploy.planned_run import Run
from sim_server.errors import SimError
from sim_server.run_folder import EVENTS, METRICS, RUN, TRACE, write_json

LONGEST_S = 1800.0
"""Wall time after which a run is given up: a hundred times what the longest should take."""


COST = "cost.json"
"""In every run folder of a batch: wall time and the processor time of all its processes, and those left over."""


_GOING_ON: set[subprocess.Popen[bytes]] = set()
"""Runs of this process."""


class BatchError(SimError):
    """A run of a batch could not be run. What the others left stays, and is not run again."""

    exit_status = COULD_NOT_RUN


@dataclass(frozen=True, slots=True)
class Done:
    """A run that has ended."""

    run: Run
    problem: str
    """Why there is nothing in the folder; empty if there is."""


class Engine(Protocol):
    """Where runs are run."""

    def run_all(self, runs: Sequence[Run], root: Path) -> Iterator[Done]:
        """Run them all, in any order, and tell of each as it ends."""
        ...


def is_there(run: Run, root: Path) -> bool:
    """Whether the folder holds this very run, whole."""
    folder = root / run.place
    if not all((folder / name).exists() for name in (RUN, METRICS, TRACE)):
        return False
    try:
        found = json.loads((folder / RUN).read_text(encoding="utf-8"))
        is_it = bool(found["scenario"] == run.resolved() and found["ended"]["completed"])
        return is_it and (run.may_lose or not lost_agents(folder))
    except (OSError, ValueError, LookupError, TypeError):
        return False


def lost_agents(folder: Path) -> list[str]:
    """Who was lost in a run, with the reason. Raises ``OSError`` and ``ValueError`` where the events cannot be read."""
    lines = (folder / EVENTS).read_text(encoding="utf-8").splitlines()
    return [f"{event['agent']} ({event['why']})" for event in map(json.loads, lines) if event["kind"] == "lost"]


def run_one(run: Run, folder: str, *, cwd: str | None = None) -> str:
    """Run it into this folder, in place of what is there; what was in the way, or nothing.

    A verdict is no problem, whatever it is: who asked for the run judges it. What it cost is left beside the run, and
    which of its processes were still there when its command had ended.

    Args:
        cwd: folder in which the command runs and a law of the user's own is looked for; the present one by default.
    """
    folder = str(Path(folder).absolute())  # also if the command runs elsewhere
    shutil.rmtree(folder, ignore_errors=True)
    began_s = time.monotonic()
    command = [sys.executable, "-m", "deploy.cli", "run", run.scenario, "--seed", str(run.seed), "--out", folder]
    command += ["--no-picture"]  # matplotlib would cost a second of every run
    for setting in run.settings():
        command += ["--set", setting]
    with tempfile.TemporaryFile("w+") as words:
        launched = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=words, cwd=cwd)
        over = threading.Timer(LONGEST_S, launched.terminate)  # it ends its processes then
        over.start()
        _GOING_ON.add(launched)
        try:
            _, status, used = os.wait4(launched.pid, 0)
            launched.returncode = os.waitstatus_to_exitcode(status)
        except BaseException:
            launched.terminate()
            launched.wait()
            raise
        finally:
            _GOING_ON.discard(launched)
            over.cancel()
        words.seek(0)
        said = words.read().strip().splitlines()
    took_s = time.monotonic() - began_s
    if took_s >= LONGEST_S:
        return f"not at its end after {LONGEST_S:g} s"
    if (Path(folder) / METRICS).exists():
        if not run.may_lose and (lost := lost_agents(Path(folder))):
            return f"lost {', '.join(lost)}, which nobody ordered: not the run that was asked for"
        cost = {"wall_s": round(took_s, 2), "processor_s": used.ru_utime + used.ru_stime}
        write_json(Path(folder) / COST, {**cost, "left_over": left_over(Path(folder))})
        return ""
    return f"exit status {launched.returncode}: {said[-1] if said else 'it said nothing'}"


class LocalEngine:
    """This machine's cores.

    Args:
        at_once: how many runs at a time.
    """

    def __init__(self, at_once: int | None = None) -> None:
        self._at_once = at_once or os.cpu_count() or 1

    def run_all(self, runs: Sequence[Run], root: Path) -> Iterator[Done]:
        with ThreadPoolExecutor(self._at_once) as pool:
            waiting = {pool.submit(run_one, run, str(root / run.place)): run for run in runs}
            try:
                for future in as_completed(waiting):
                    run = waiting[future]
                    yield Done(run, future.result())
            except BaseException:  # whoever ends the batch, however, waits for no run
                for future in waiting:
                    future.cancel()
                for launched in list(_GOING_ON):
                    launched.terminate()
                raise
            finally:
                pool.shutdown(cancel_futures=True)


class RayEngine:
    """A Ray cluster (the extra ``ray``) whose machines share the batch's folder.

    Args:
        address: of the cluster; None for the one that RAY_ADDRESS names, or one of this machine's own.

    Raises:
        BatchError: Ray is not installed.
    """

    def __init__(self, address: str | None = None) -> None:
        try:
            import ray
        except ImportError:
            raise BatchError("--engine ray: Ray is not installed; pip install 'palanquin[ray]'") from None
        self._ray: Any = ray
        ray.init(address=address, ignore_reinit_error=True, log_to_driver=False)

    def run_all(self, runs: Sequence[Run], root: Path) -> Iterator[Done]:
        remote: Callable[..., Any] = self._ray.remote(num_cpus=1)(run_one).remote
        waiting: dict[Any, Run] = {remote(run, str((root / run.place).absolute())): run for run in runs}
        while waiting:
            (ended,), _ = self._ray.wait(list(waiting), num_returns=1)
            run = waiting.pop(ended)
            yield Done(run, self._ray.get(ended))


def engine_of(name: Literal["local", "ray"], at_once: int | None, ray_address: str | None) -> Engine:
    """Where a command line wants its runs. Raises :class:`BatchError` if that is not to be had."""
    return RayEngine(ray_address) if name == "ray" else LocalEngine(at_once)


def missing(runs: Iterable[Run], root: Path) -> list[Run]:
    """Those that are not there yet, each once."""
    once = {run.place: run for run in reversed(list(runs))}
    return [run for run in reversed(once.values()) if not is_there(run, root)]


def run_missing(runs: Sequence[Run], root: Path, engine: Engine, told: Callable[[int, int], None]) -> Mapping[str, str]:
    """Run what is not there yet; the problems by the run's place.

    Args:
        told: called with how many are there and how many there are to be, at the start and after each.
    """
    to_do, total = missing(runs, root), len({run.place for run in runs})
    there, problems = total - len(to_do), dict[str, str]()
    told(there, total)
    for done in engine.run_all(to_do, root):
        there += 1
        if done.problem:
            problems[done.run.place] = done.problem
        told(there, total)
    return problems
