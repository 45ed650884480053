"""What it costs to be watched: ``python benchmarks/recording_cost.py [ROUNDS [SECONDS]]``. Prints, asserts nothing.

Real-time factor of ``transport`` in lock-step alone, recorded, and with a recorder that is stopped (SIGSTOP) from the
first tick to the last; one of each in turn, so that a machine that changes its speed changes all of a round.
"""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from deploy.see.viewing import RECORDING
from sim_server.run_folder import EVENTS, LOGS, read_run

KINDS = ("alone", "recorded", "recorder stopped")
POLL_S = 0.05


def happened(folder: Path, kind: str) -> bool:
    """Whether such an event has been written."""
    file = folder / EVENTS
    return file.exists() and f'"kind": "{kind}"' in file.read_text()


def recorder_of(launcher: int) -> int:
    """The process number of the recorder of a launched run."""
    listed = subprocess.run(["ps", "-o", "pid=,args=", "--ppid", str(launcher)], capture_output=True, text=True)
    return next(int(line.split()[0]) for line in listed.stdout.splitlines() if " record " in line)


def real_time_factor(kind: str, seconds: float, folder: Path) -> float:
    """Of one run."""
    command = [sys.executable, "-m", "deploy.cli", "run", "transport", "--no-picture", "--out", str(folder)]
    command += ["--set", f"duration_s={seconds!r}", *([] if kind == "alone" else ["--record"])]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    if kind == "recorder stopped":
        while run.poll() is None and not happened(folder, "started"):
            time.sleep(POLL_S)
        recorder = recorder_of(run.pid)
        os.kill(recorder, signal.SIGSTOP)
        while run.poll() is None and not happened(folder, "ended"):
            time.sleep(POLL_S)
        os.kill(recorder, signal.SIGCONT)
    run.wait()
    return float(read_run(folder)["measured"]["real_time_factor"])


def main(rounds: int, seconds: float) -> None:
    """Print each run and the medians."""
    found: dict[str, list[float]] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as place:
        for number in range(rounds):
            for turn in range(len(KINDS)):
                kind = KINDS[(number + turn) % len(KINDS)]
                folder = Path(place) / f"{number}-{turn}"
                found[kind].append(real_time_factor(kind, seconds, folder))
                log, file = folder / LOGS / "recorder.log", folder / RECORDING
                said = f"{log.read_text().splitlines()[-1]}; {file.stat().st_size / 1e6:.1f} MB" if log.exists() else ""
                load = os.getloadavg()[0]
                print(f"{kind:17} x{found[kind][-1]:.3f} real time  load {load:.1f}  {said}", flush=True)
    alone = statistics.median(found["alone"])
    for kind, factors in found.items():
        median = statistics.median(factors)
        print(f"{kind:17} median x{median:.3f}, {median / alone:.3f} of alone")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5, float(sys.argv[2]) if len(sys.argv) > 2 else 6.0)
