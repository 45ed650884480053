"""The simulator's errors: what, where, got, expected, what to do next."""

from __future__ import annotations

import os


class SimError(Exception):
    """Base of every error that the simulation side raises on purpose.

    Attributes:
        exit_status: what a command line that ends with this error exits with (2 bad input, 3 could not run).
    """

    exit_status = 2


class PlantFailed(SimError):
    """The simulated physics left the range of sense: nothing after this moment means anything."""

    exit_status = 3


class ScenarioError(SimError):
    """A scenario file cannot be used. Carries the file and the key at fault.

    Attributes:
        file: the scenario's file name, or its name when it came with the package.
        key: dotted path of the key at fault, for example ``load.mass_kg``.
    """

    def __init__(self, file: str, key: str, problem: str, *, expected: str = "", fix: str = "") -> None:
        self.file, self.key, self.problem, self.expected, self.fix = file, key, problem, expected, fix
        text = f"{file}: {key}: {problem}" if key else f"{file}: {problem}"
        if expected:
            text += f"; expected {expected}"
        if fix:
            text += f". {fix}"
        super().__init__(text)


class CannotRender(SimError):
    """There is nothing to render with."""

    exit_status = 3

    def __init__(self, problem: Exception) -> None:
        by = os.environ.get("MUJOCO_GL", "default")
        super().__init__(
            f"no picture can be rendered: MuJoCo found no library for off-screen OpenGL ({by}: {problem}); expected "
            "EGL (Debian: apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri) or OSMesa (libosmesa6, with "
            "MUJOCO_GL=osmesa)"
        )
