"""A process that compiles the model of a world with other robots, while the simulator goes on.

``python -m sim_server.world_builder``: reads ``{"scenario": {...}, "seats": {"a1": 0, ...}, "to": FILE}`` from its
standard input and writes the compiled model to FILE. In the simulator's own process it would hold the ticks up.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

from sim_server.errors import SimError
from sim_server.scenario import Scenario
from sim_server.scene import read_model, write_model
from sim_server.world import World, build_world, with_robots

BUILD_S = 60.0


class NotBuilt(SimError):
    """The world with the newcomer could not be built."""

    exit_status = 3


class Build:
    """A world that is being built for these seats (arm: its strut, from 0)."""

    def __init__(self, scenario: Scenario, seats: Mapping[str, int]) -> None:
        self.seats = dict(seats)
        self._folder = Path(tempfile.mkdtemp(prefix="palanquin-world-"))
        self._file = self._folder / "model.mjb"
        self._assembly: Generator[None, None, World] | None = None
        self._world: World | None = None
        self._problem = ""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "sim_server.world_builder"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
            text=True,
        )
        if self._process.stdin is not None:
            with self._process.stdin as ask:
                self._process.stdin = None
                ask.write(json.dumps({"scenario": scenario.model_dump(), "seats": self.seats, "to": str(self._file)}))

    def advance(self, here: World) -> bool:
        """Do a little of what is left to do in this process, a millisecond or so; True when :meth:`world` has nothing
        more to wait for. ``here`` is the world that there is now."""
        if self._world is None and not self._problem and self._process.poll() is not None:
            if self._assembly is None:
                model = self._model()
                self._assembly = None if model is None else with_robots(here, self.seats, model)
            else:
                self._step(self._assembly)
        return self._world is not None or bool(self._problem)

    def world(self, here: World) -> World:
        """The world, waited for if need be. Raises :class:`NotBuilt`."""
        try:
            self._process.wait(BUILD_S)
        except subprocess.TimeoutExpired:
            self.end()
            raise NotBuilt(f"the world was not built within {BUILD_S:g} s") from None
        while not self.advance(here):
            pass
        if self._world is None:
            raise NotBuilt(self._problem)
        return self._world

    def _step(self, assembly: Generator[None, None, World]) -> None:
        try:
            next(assembly)
        except StopIteration as end:
            self._world = end.value

    def _model(self) -> Any:
        """The model that the other process made; None if it did not, and why is the problem."""
        try:
            if self._process.returncode == 0:
                return read_model(self._file)
            errors = self._process.stderr.read() if self._process.stderr else ""
            last = errors.strip().splitlines()[-1:] or ["it said nothing"]
            self._problem = f"the world with {', '.join(self.seats)} could not be built: {last[0]}"
            return None
        finally:
            self.end()

    def end(self) -> None:
        """Nobody wants it any more."""
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)


def main() -> None:
    asked = json.load(sys.stdin)
    write_model(build_world(Scenario.model_validate(asked["scenario"]), asked["seats"]).model, Path(asked["to"]))


if __name__ == "__main__":
    main()
