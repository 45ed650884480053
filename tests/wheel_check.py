"""``make wheel-check``: the built wheel in a new environment, far from the checkout, runs a scenario to its verdict.

With pipx, if that is there, as a user would; else with venv and pip, which is what pipx does. Not a test of ``make
test``, because it installs everything anew from the package index.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
RUN = ["run", "transport", "--out", "runs/transport"]


def run(command: Sequence[str | Path], cwd: Path, environment: dict[str, str]) -> str:
    """Run it to its end; its output. A failure ends the check with what was said."""
    start = time.monotonic()
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    print(f"{time.monotonic() - start:6.1f} s  {' '.join(map(str, command))}", flush=True)
    if done.returncode:
        sys.exit(f"status {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def main() -> None:
    """Build, install, run; the folder goes at the end."""
    environment = {
        key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    }
    with tempfile.TemporaryDirectory(prefix="palanquin-wheel-") as made:
        away = Path(made)
        source = away / "source"
        keep_out = shutil.ignore_patterns(".*", "runs", "build", "dist", "*.egg-info", "__pycache__")
        shutil.copytree(REPOSITORY, source, ignore=keep_out)
        build = [
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "--quiet",
            "--no-deps",
            "--no-build-isolation",
            "--wheel-dir",
            ".",
        ]
        run([*build, source], away, environment)
        shutil.rmtree(source)
        (wheel,) = away.glob("*.whl")
        if pipx := shutil.which("pipx"):
            environment |= {"PIPX_HOME": str(away / "pipx"), "PIPX_BIN_DIR": str(away / "bin")}
            run([pipx, "install", "--python", sys.executable, f"{wheel}[all]"], away, environment)
            palanquin = away / "bin" / "palanquin"
        else:
            run([sys.executable, "-m", "venv", away / "venv"], away, environment)
            pip = away / "venv" / "bin" / "python"
            run(
                [pip, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"{wheel}[all]"],
                away,
                environment,
            )
            palanquin = away / "venv" / "bin" / "palanquin"
        version = run([palanquin, "--version"], away, environment)
        said = run([palanquin, *RUN], away, environment)
        if "verdict: holds" not in said:
            sys.exit(f"no verdict:\n{said[-2000:]}")
        print(f"palanquin {version.strip()} from the wheel: {said.strip().splitlines()[-2]}")


if __name__ == "__main__":
    main()
