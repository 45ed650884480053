"""Robots that come while the load is in the air.

Before a newcomer's tick another process builds the world that it is in, and the launcher starts its agent, while the
simulation goes on. At its tick the worlds are exchanged and its greeting is answered; from then on it is a robot like
the others, whose agent drives it to its strut. Robots that hold nothing and whose agents have gone are taken away then.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from sim_server.errors import SimError
from sim_server.mujoco_plant import MujocoPlant
from sim_server.reception import Reception
from sim_server.scenario import Scenario
from sim_server.world_builder import Build
from wire.lifecycle import Phase

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
        """Begin to build its world, and expect its greeting."""
        seats = self._seats_with(arm, strut)
        self._coming[arm] = Coming(arm, strut, Build(self._scenario, seats))
        self._invite(arm)

    def check(self, strut: int, promised: Collection[int]) -> None:
        """Raises :class:`CannotCome` if nobody can come to this strut now.

        Args:
            strut: from 0.
            promised: struts of those who are to come anyway.
        """
        struts, seats = self._scenario.load.struts, self._seats()
        if self._scenario.base.fixed:
            raise CannotCome(f"strut {strut + 1}: the bases of this scenario are fixed: nobody can drive to it")
        if not 0 <= strut < struts:
            raise CannotCome(f"strut {strut + 1}: the load has struts 1 to {struts}")
        self._check_free(strut, seats)
        if strut in promised:
            raise CannotCome(f"strut {strut + 1}: somebody is to come to it already")
        if len(seats) + len(promised) >= MAX_ROBOTS:
            raise CannotCome(f"{MAX_ROBOTS} robots are there or to come: expected one to leave first")

    def advance(self) -> None:
        """A little work on the worlds that are to come, tick by tick; one that somebody has left is begun anew."""
        for coming in self._coming.values():
            seats = self._seats_with(coming.arm, coming.strut)
            if coming.build.seats != seats:
                coming.build.end()
                coming.build = Build(self._scenario, seats)
            coming.build.advance(self._plant.world)

    def is_ready(self, arm: str) -> bool:
        """Whether its world is built."""
        return self._coming[arm].build.advance(self._plant.world)

    def arrive(self, arm: str) -> float:
        """Exchange the worlds; the wall time that took, s.

        Raises:
            CannotCome: its strut is not free.
            NotBuilt: there is no world with it.
        """
        start = time.perf_counter()
        coming, stay = self._coming[arm], self._seats()
        self._check_free(coming.strut, stay)
        build, seats = coming.build, {**stay, arm: coming.strut}
        if build.seats != seats:  # somebody left at this very tick, or another who was to come first has not
            build.end()
            build = Build(self._scenario, seats)
        world = build.world(self._plant.world)
        del self._coming[arm]
        gone = set(self._plant.names) - set(seats)
        self._plant.move_to(world)
        for name in gone:
            self._reception.dismiss(name, "its robot has been taken away")
        self._changed(self._plant.names)
        self._reception.let_in(arm)
        return time.perf_counter() - start

    def cancel(self, arm: str, why: str) -> None:
        """It does not come after all; its agent hears why."""
        if coming := self._coming.pop(arm, None):
            coming.build.end()
        if arm in self._reception.agents:
            self._reception.dismiss(arm, why)

    def end(self) -> None:
        """The run is over: nobody comes any more."""
        for coming in self._coming.values():
            coming.build.end()
        self._coming.clear()

    def _seats_with(self, arm: str, strut: int) -> dict[str, int]:
        """Who is there when it comes: those who stay, those who come before it, and itself."""
        seats = dict(self._seats())
        for before in self._coming.values():
            if before.arm == arm:
                break
            seats[before.arm] = before.strut
        return {**seats, arm: strut}

    def _seats(self) -> Mapping[str, int]:
        """The robots that stay when the next one comes, each with its strut: all but those that hold nothing and whose
        agents have gone."""
        return {
            name: ids.strut
            for name, ids in self._plant.world.arms.items()
            if self._plant.hands.holds(name) or self._reception.agents[name].link.phase not in (Phase.LOST, Phase.LEFT)
        }

    def _check_free(self, strut: int, seats: Mapping[str, int]) -> None:
        for name, theirs in seats.items():
            if theirs == strut:
                what = "is held by" if self._plant.hands.holds(name) else "is the one to be taken by"
                if self._reception.agents[name].link.leaving:
                    what = "has not been left yet by"
                raise CannotCome(f"strut {strut + 1} {what} {name}: a newcomer needs a free one")
