"""Robots that come while the load is in the air.

Before a newcomer's tick another process builds the world that it is in, and the launcher starts its agent, while the
simulation goes on. At its tick the worlds are exchanged and its greeting is answered; from then on it is a robot like
the others, whose agent drives it to its strut. Robots that have left, with an open hand, are taken away then.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from sim_server.errors import SimError
from sim_server.mujoco_plant import MujocoPlant
from sim_server.reception import Reception
from sim_server.scenario import Scenario
from sim_server.world_builder import Build

MAX_ROBOTS = 16


class CannotCome(SimError):
    """No robot can take that strut now."""


@dataclass(slots=True)
class Coming:
    """A robot on its way."""

    arm: str
    strut: int
    """From 0."""
    build: Build


class Newcomers:
    """All that are on their way.

    Args:
        invite: lets a name be greeted from now on, with its greeting held back.
        changed: called after every exchange of worlds, with the names of the robots that are there now.
    """

    def __init__(
        self,
        scenario: Scenario,
        plant: MujocoPlant,
        reception: Reception,
        invite: Callable[[str], None],
        changed: Callable[[Sequence[str]], None],
    ) -> None:
        self._scenario, self._plant, self._reception = scenario, plant, reception
        self._invite, self._changed = invite, changed
        self._coming: dict[str, Coming] = {}
        self._names = {*scenario.arms, *scenario.joining}

    def know(self, arm: str) -> None:
        """That name has been had."""
        self._names.add(arm)

    def next_name(self) -> str:
        """A name that nobody has had."""
        name = f"a{max(int(name[1:]) for name in self._names) + 1}"
        self._names.add(name)
        return name

    def prepare(self, arm: str, strut: int) -> None:
        """Begin to build its world, and expect its greeting. Raises :class:`CannotCome`."""
        self._build(arm, strut)
        self._invite(arm)

    def check(self, strut: int) -> None:
        """Raises :class:`CannotCome` if nobody can come to this strut (from 0) now."""
        struts = self._scenario.load.struts
        if not 0 <= strut < struts:
            raise CannotCome(f"strut {strut + 1}: the load has struts 1 to {struts}")
        if self._plant.hands.is_held(strut):
            raise CannotCome(f"strut {strut + 1} is held by {self._holder(strut)}: a newcomer needs a free one")
        if any(coming.strut == strut for coming in self._coming.values()):
            raise CannotCome(f"strut {strut + 1}: somebody is on the way to it already")
        if len(self._seats()) + len(self._coming) >= MAX_ROBOTS:
            raise CannotCome(f"{MAX_ROBOTS} robots are there: expected one to leave first")

    def advance(self) -> None:
        """A little work on the worlds that are to come, tick by tick."""
        for coming in self._coming.values():
            coming.build.advance(self._plant.world)

    def is_ready(self, arm: str) -> bool:
        """Whether its world is built."""
        return self._coming[arm].build.advance(self._plant.world)

    def arrive(self, arm: str) -> float:
        """Exchange the worlds; the wall time that took, s.

        Raises:
            CannotCome: its strut is held.
            NotBuilt: there is no world with it.
        """
        start = time.perf_counter()
        coming = self._coming.pop(arm)
        seats = {**self._seats(), arm: coming.strut}
        if self._plant.hands.is_held(coming.strut):
            coming.build.end()
            raise CannotCome(f"strut {coming.strut + 1} is held by {self._holder(coming.strut)}: {arm} has no place")
        build = coming.build
        if build.seats != seats:  # somebody left in the meantime
            build.end()
            build = Build(self._scenario, seats)
        world = build.world(self._plant.world)
        self._plant.move_to(world)
        self._changed(self._plant.names)
        self._reception.let_in(arm)
        return time.perf_counter() - start

    def cancel(self, arm: str) -> None:
        """It does not come after all."""
        if coming := self._coming.pop(arm, None):
            coming.build.end()

    def end(self) -> None:
        """The run is over: nobody comes any more."""
        for coming in self._coming.values():
            coming.build.end()
        self._coming.clear()

    def _build(self, arm: str, strut: int) -> None:
        seats = {**self._seats(), **{each.arm: each.strut for each in self._coming.values()}, arm: strut}
        self._coming[arm] = Coming(arm, strut, Build(self._scenario, seats))

    def _seats(self) -> Mapping[str, int]:
        """The robots that stay when the next one comes, each with its strut."""
        return {
            name: ids.strut
            for name, ids in self._plant.world.arms.items()
            if not self._plant.hands.is_empty(name) or self._reception.agents[name].is_in
        }

    def _holder(self, strut: int) -> str:
        return next(
            name
            for name, ids in self._plant.world.arms.items()
            if ids.strut == strut and not self._plant.hands.is_empty(name)
        )
