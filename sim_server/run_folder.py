"""The folder that a run leaves: run.json, metrics.json, audit.json, trace.parquet, events.jsonl. (logs/ is the
launcher's.)"""

from __future__ import annotations

import fcntl
import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO, get_args

from sim_server.errors import SimError
from sim_server.metrics import physical_metrics, trace_facts
from sim_server.scenario import Bound
from sim_server.trace import read_trace
from sim_server.verdict import Judged, Verdict, judge, overall, why_unknown

RUN, METRICS, AUDIT = "run.json", "metrics.json", "audit.json"
TRACE, EVENTS, LOGS = "trace.parquet", "events.jsonl", "logs"


class RunFolderError(SimError):
    """A run folder cannot be made, or what is in it cannot be used."""


class RunFolder:
    """An open run folder; the events file is written line by line.

    Raises:
        RunFolderError: the folder holds a run already, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _claiming(path):
            self._events: TextIO = (path / EVENTS).open("x", encoding="utf-8")
        self._lock = _lock(path)

    @classmethod
    def of_a_run(cls, path: Path) -> RunFolder:
        """The folder of a run that is to go on. Nothing in it changes before :meth:`rewind`.

        Raises:
            RunFolderError: another simulator has it, or it cannot be written.
        """
        self = cls.__new__(cls)
        self.path, self._lock = path, _lock(path)
        try:
            self._events = (path / EVENTS).open("r+", encoding="utf-8")
        except OSError as error:
            os.close(self._lock)
            raise RunFolderError(f"{path / EVENTS} cannot be opened: {error.strerror}") from None
        return self

    def rewind(self, size: int) -> None:
        """Mark what the events say beyond their first ``size`` bytes as undone: it happened, but the run goes on from
        before it. A line that was not finished is dropped."""
        self._events.close()
        file = self.path / EVENTS
        data = file.read_bytes()
        undone = [json.loads(line) | {"undone": True} for line in data[size:].splitlines(True) if line.endswith(b"\n")]
        part = file.with_suffix(".part")
        part.write_bytes(data[:size] + b"".join(json.dumps(event).encode() + b"\n" for event in undone))
        os.replace(part, file)
        self._events = file.open("a", encoding="utf-8")

    def times(self, kind: str, event: str) -> int:
        """How often the events' file tells that of an event of the scenario, what was undone included."""
        lines = (self.path / EVENTS).read_text(encoding="utf-8").splitlines()
        return sum((found := json.loads(line))["kind"] == kind and found.get("event") == event for line in lines)

    def events_bytes(self) -> int:
        """How long the events file is now."""
        return os.fstat(self._events.fileno()).st_size

    @property
    def trace(self) -> Path:
        """Where the trace goes."""
        return self.path / TRACE

    def event(self, tick: int, time_s: float, kind: str, **details: object) -> None:
        """Append one event and push it out."""
        self._events.write(json.dumps({"tick": tick, "time_s": round(time_s, 6), "kind": kind, **details}) + "\n")
        self._events.flush()

    def close(self) -> None:
        if not self._events.closed:
            self._events.close()
            os.close(self._lock)


def claim_logs(path: Path) -> Path:
    """Make a run folder with its ``logs`` folder, which must not be there yet, and return that.

    Raises:
        RunFolderError: the folder holds a run already, or cannot be written.
    """
    with _claiming(path):
        (path / LOGS).mkdir()
    return path / LOGS


def _lock(path: Path) -> int:
    """Keep the folder for this process, however it ends; the descriptor that does so.

    Raises:
        RunFolderError: another process keeps it.
    """
    try:
        folder = os.open(path, os.O_RDONLY)
    except OSError as error:
        raise RunFolderError(f"{path} cannot be opened: {error.strerror}") from None
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(folder)
        raise RunFolderError(f"{path}: a simulator is writing this run: expected one that has ended") from None
    except OSError:
        pass  # a file system without locks
    return folder


@contextmanager
def _claiming(path: Path) -> Iterator[None]:
    """Make the folder; what the body creates exclusively there is the claim, so that two runs never share one."""
    taken = f"{path} holds a run already: expected a new folder; choose another with --out"
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any((path / name).exists() for name in (RUN, METRICS, TRACE, EVENTS)):
            raise RunFolderError(taken)
        yield
    except FileExistsError as error:
        raise RunFolderError(taken if path.is_dir() else f"{path} is a file, not a folder ({error.strerror})") from None
    except OSError as error:
        raise RunFolderError(f"cannot write to {path}: {error.strerror}; choose another folder with --out") from None


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(part, path)


def read_run(path: Path) -> dict[str, Any]:
    """The content of a folder's run.json.

    Raises:
        RunFolderError: it is no run folder.
    """
    missing = f"{path} is no run folder: expected a file {RUN} in it"
    if (path / "checkpoint").is_dir():
        missing = (
            f"{path}: this run has not ended: expected a file {RUN} in it; if its simulator was killed, go on with "
            f"`palanquin sim --resume {path}`"
        )
    return _read_json(path / RUN, missing)


def read_audit(path: Path) -> dict[str, Any]:
    """The content of a folder's audit.json.

    Raises:
        RunFolderError: it is no run folder, or one of a run that was not audited.
    """
    read_run(path)
    missing = f"{path} has no {AUDIT}: this run was recorded before runs were audited; run the scenario again"
    found = _read_json(path / AUDIT, missing)
    fields = (("verdict", str), ("why", list), ("processes", dict), ("counts", list))
    if wrong := [name for name, kind in fields if not isinstance(found.get(name), kind)]:
        raise RunFolderError(f"{path / AUDIT} is no audit: {', '.join(wrong)} missing or of the wrong type")
    if found["verdict"] not in get_args(Verdict):
        expected = " or ".join(get_args(Verdict))
        raise RunFolderError(f"{path / AUDIT} is no audit: verdict: got {found['verdict']!r}, expected {expected}")
    return found


def _read_json(path: Path, missing: str) -> dict[str, Any]:
    """A JSON object; ``missing`` is what to say when there is no such file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise RunFolderError(missing) from None
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{path} cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise RunFolderError(f"{path} cannot be read: got a {type(content).__name__}, expected an object")
    return content


def compute_metrics(path: Path) -> tuple[dict[str, Any], tuple[Judged, ...]]:
    """All metrics of a run folder from its trace and run.json, with the verdict, and each bound beside its value.

    Raises:
        RunFolderError: the trace or run.json is missing, cut off, or does not fit.
    """
    run = read_run(path)
    try:
        expect = {name: Bound.model_validate(bound) for name, bound in run["scenario"]["expect"].items()}
        metrics: dict[str, Any] = dict(physical_metrics(read_trace(path / TRACE), trace_facts(run["facts"])))
        metrics |= {name: value for name, value in run["measured"].items() if name not in metrics}
        completed, why = bool(run["ended"]["completed"]), str(run["ended"].get("why", ""))
        unproven = [str(each) for each in run.get("unproven", [])]
    # An edited or cut-off folder can fail in any of these ways; each means the same.
    except (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        problem = " ".join(str(error).split())
        raise RunFolderError(f"{path}: no metrics can be computed: {type(error).__name__}: {problem}") from None
    metrics = {name: _finite(value) for name, value in metrics.items()}
    judged = judge(metrics, expect)
    metrics["verdict"] = overall(judged, completed, unproven)
    if metrics["verdict"] == "unknown":
        metrics["why_unknown"] = why_unknown(judged, None if completed else why, unproven)
    return metrics, judged


def _finite(value: Any) -> Any:
    """The value, without numbers that a failed physics left behind: they say nothing and are no JSON."""
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
