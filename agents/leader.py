"""The leader process: sees the load, knows the goal or obeys a person, pulls with a bounded force. Nobody else can hear
it."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from agents.errors import AgentError
from agents.person import Person
from agents.pulling import Array, bounded_pull, rotate, wished_pull
from agents.session import AgentSession, RunEnded, SimulatorGone, here
from agents.waypoints import NEAR_M, Place, Waypoints
from agents.wish import Wish
from wire.errors import Reason, Refused
from wire.keys import Keys
from wire.link import Link
from wire.messages import Hello, LeaderForce, LeaderView, Welcome

log = logging.getLogger("palanquin.leader")


class LeaderSettingsError(AgentError):
    """The leader was told something that it cannot pull towards."""

    exit_status = 2


NO_REAL_TIME = "what a person wants is looked at once a view, whatever wall time that is, and the run will not repeat"


def read_waypoint(text: str) -> Place:
    """From ``X,Y``. Raises :class:`LeaderSettingsError`."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        raise LeaderSettingsError(f"leader: waypoint {text!r}: expected X,Y in m, such as 0.8,0.4") from None
    return x, y


@dataclass(frozen=True, slots=True)
class Stop:
    """A place on the way: the leader pulls there, and holds the load there, until a simulated time."""

    goal_m: tuple[float, float]
    """Where the load's frame O shall be meanwhile, (2,) m, world."""
    until_s: float

    @classmethod
    def read(cls, text: str) -> Stop:
        """From ``X,Y,UNTIL_S``. Raises :class:`LeaderSettingsError`."""
        try:
            x, y, until_s = map(float, text.split(","))
        except ValueError:
            raise LeaderSettingsError(
                f"leader: stop {text!r}: expected X,Y,UNTIL_S in m and s, such as 0.8,0,12"
            ) from None
        return cls((x, y), until_s)

    @property
    def until_ns(self) -> int:
        """The same time as the simulator's clock counts it."""
        return round(self.until_s * 1e9)


@dataclass(frozen=True, slots=True)
class LeaderSettings:
    """The leader's goal, the stops before it, and how it pulls."""

    run: str
    goal_m: tuple[float, float]
    """Where the load's frame O shall end, (2,) m, world."""
    force_max_N: float = 40.0
    stiffness_N_m: float = 100.0
    damping_Ns_m: float = 320.0
    point: str = "front"
    """Name of the point of the load that is pulled."""
    join_timeout_s: float = 30.0
    stops: tuple[Stop, ...] = ()
    """Where to pull before, each until its time."""
    wait_s: float = 0.0
    """How long to stand in line while another leader is in."""
    reconnect_s: float = 0.0
    """Wall time to wait for a simulator that is gone to come back; 0: end when it goes."""
    waypoints: tuple[Place, ...] = ()
    """Where to pull before, each until the load has come near."""
    near_m: float = NEAR_M
    """From where on a waypoint counts as reached."""

    def __post_init__(self) -> None:
        for what, value in (
            ("goal", self.goal_m[0]),
            ("goal", self.goal_m[1]),
            ("force bound", self.force_max_N),
            ("stiffness", self.stiffness_N_m),
            ("damping", self.damping_Ns_m),
            ("time to wait", self.wait_s),
            ("radius of the waypoints", self.near_m),
            *((f"waypoint {k}", x) for k, place in enumerate(self.waypoints, start=1) for x in place),
        ):
            if not math.isfinite(value):
                raise LeaderSettingsError(f"leader: {what}: got {value}, expected a finite number")
        if self.stops and self.waypoints:
            raise LeaderSettingsError("leader: got stops and waypoints, expected one of the two: times, or places")
        before_s = 0.0
        for number, stop in enumerate(self.stops, start=1):
            for value in (*stop.goal_m, stop.until_s):
                if not math.isfinite(value):
                    raise LeaderSettingsError(f"leader: stop {number}: got {value}, expected a finite number")
            if stop.until_s <= before_s:
                raise LeaderSettingsError(
                    f"leader: stop {number}: until {stop.until_s:g} s, expected later than {before_s:g} s"
                )
            before_s = stop.until_s

    def target_m(self, time_ns: int) -> tuple[float, float]:
        """Where the load shall be pulled at this simulated time: the first stop that is not over, or the goal."""
        return next((stop.goal_m for stop in self.stops if time_ns < stop.until_ns), self.goal_m)


def pull(view: LeaderView, point_O: Array, settings: LeaderSettings, aim: Place | Wish | None = None) -> Array:
    """The leader's force for one view of the load, (3,) N, world; its vertical part is zero.

    Args:
        point_O: the point that is pulled, (3,) m, in the load's frame O.
        aim: a place to pull to, (2,) m, world, or what a person wants; by default the stop of this time, or the goal.
    """
    arm_W = rotate(np.array(view.quat_wxyz), point_O)
    velocity = (np.array(view.linear_velocity) + np.cross(np.array(view.angular_velocity), arm_W))[:2]
    damping, force_max = settings.damping_Ns_m, settings.force_max_N
    if isinstance(aim, Wish):
        planar = wished_pull(aim, velocity, damping, force_max)
    else:
        error = np.array(aim or settings.target_m(view.time_ns)) - np.array(view.position[:2])
        planar = bounded_pull(error, velocity, settings.stiffness_N_m, damping, force_max)
    return np.array([planar[0], planar[1], 0.0])


class Aims:
    """What the leader pulls to at each view: what a person wants, or the next waypoint, stop or goal."""

    def __init__(self, settings: LeaderSettings, person: Person | None) -> None:
        self._waypoints, self._person = Waypoints(settings.waypoints, settings.near_m), person

    def at(self, view: LeaderView) -> Place | Wish | None:
        """The aim for :func:`pull`; a person's is the newest wish."""
        if self._person is not None:
            return self._person.wish
        return self._waypoints.next_place(view.time_ns, (view.position[0], view.position[1]))

    def described(self, settings: LeaderSettings, clock: str) -> str:
        """For the log."""
        if self._person is not None:
            means = "" if clock == "real-time" else f"; the clock is {clock}: {NO_REAL_TIME}"
            return f"as a person wants, {settings.force_max_N:g} N at most{means}"
        by_time = "".join(f"{stop.goal_m} until {stop.until_s:g} s, then " for stop in settings.stops)
        by_place = "".join(f"{place} until {settings.near_m:g} m from it, then " for place in settings.waypoints)
        return f"towards {by_time}{by_place}{settings.goal_m}"

    @property
    def is_given_up(self) -> bool:
        """Whether a person has had enough."""
        return self._person is not None and self._person.departure.wanted


def run_leader(link: Link, settings: LeaderSettings, person: Person | None = None) -> str:
    """Join, pull at every view until the run ends, or the person who leads goes, and return why it ended.

    Raises:
        NotWelcome, AgentError: not let in, nobody there, the simulator is gone, or the load has no such point.
    """
    keys = Keys(settings.run)
    pid, host = here()
    hello = Hello("leader", settings.run, "leader", "", "", pid, host)
    session = AgentSession(link, keys.leader, keys.sim_alive, hello, LeaderView)
    aims = Aims(settings, person)
    if person is not None:
        person.departure.heard_by(session.wake)
    try:
        welcome = session.join(settings.join_timeout_s, settings.wait_s)
        while True:
            try:
                lead(session, settings, welcome, aims)
            except SimulatorGone:
                if not settings.reconnect_s:
                    raise
                welcome = session.rejoin(settings.reconnect_s)
    except RunEnded as ended:
        return str(ended)
    except KeyboardInterrupt:
        if session.lease:
            session.leave()
        return "interrupted"
    finally:
        session.tell_refused()


def lead(session: AgentSession[LeaderView], settings: LeaderSettings, welcome: Welcome, aims: Aims) -> NoReturn:
    """Pull at every view that is newer than all before. Raises as :func:`run_leader`."""
    if settings.point not in welcome.points:
        session.leave()
        raise AgentError(
            f"leader: the load has no point {settings.point!r}; expected one of {', '.join(sorted(welcome.points))}"
        )
    point_O = np.array(welcome.points[settings.point])
    settings = replace(settings, force_max_N=min(settings.force_max_N, welcome.force_max_N))
    log.info("leader: joined, pulling %s %s", settings.point, aims.described(settings, welcome.clock))

    newest = -1

    def answer(view: LeaderView) -> LeaderForce:
        nonlocal newest
        if view.tick <= newest:
            raise Refused(Reason.STALE, "tick", view.tick, f"more than {newest}")
        newest = view.tick
        force = pull(view, point_O, settings, aims.at(view))
        return LeaderForce(view.tick, session.lease, settings.point, tuple(force.tolist()))

    while True:
        if aims.is_given_up:
            session.leave()
            raise RunEnded("left")
        if welcome.clock != "real-time":
            session.answer_each(answer)
            continue
        view = session.receive_newest(1.0)
        if view is not None:
            try:
                session.send(answer(view))
            except Refused as refusal:
                session.refuse(refusal)
