"""The leader process: sees the load, knows the goal, pulls with a bounded force. Nobody else can hear it."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from agents.errors import AgentError
from agents.session import AgentSession, RunEnded, SimulatorGone, here
from wire.errors import Reason, Refused
from wire.keys import Keys
from wire.link import Link
from wire.messages import Hello, LeaderForce, LeaderView, Welcome

log = logging.getLogger("palanquin.leader")
Array = NDArray[np.float64]


class LeaderSettingsError(AgentError):
    """The leader was told something that it cannot pull towards."""

    exit_status = 2


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

    def __post_init__(self) -> None:
        for what, value in (
            ("goal", self.goal_m[0]),
            ("goal", self.goal_m[1]),
            ("force bound", self.force_max_N),
            ("stiffness", self.stiffness_N_m),
            ("damping", self.damping_Ns_m),
            ("time to wait", self.wait_s),
        ):
            if not math.isfinite(value):
                raise LeaderSettingsError(f"leader: {what}: got {value}, expected a finite number")
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


def bounded_pull(goal_error: Array, velocity: Array, stiffness: float, damping: float, force_max: float) -> Array:
    """Pull in the plane, (2,) N: stiffness * goal_error - damping * velocity, shortened to force_max.

    Section V of the paper: a lateral force, bounded at 40 N, in the direction of the target, in proportion to the
    distance. The damping is ours: without it the load overshoots and turns round its own pull.

    Args:
        goal_error: goal minus the load's place, (2,) m, world.
        velocity: of the point that is pulled, (2,) m/s, world.
        stiffness: N/m.
        damping: N s/m.
        force_max: N.
    """
    force: Array = stiffness * goal_error - damping * velocity
    size = float(np.linalg.norm(force))
    # A hair below the bound: rounding of the shortened vector must not put its length above.
    return force if size <= force_max else force * (force_max / size * (1.0 - 1e-12))


def rotate(quat_wxyz: Array, v: Array) -> Array:
    """The vector v, (3,), turned by the unit quaternion (w, x, y, z)."""
    w, r = quat_wxyz[0], quat_wxyz[1:]
    return v + 2.0 * np.cross(r, np.cross(r, v) + w * v)


def pull(view: LeaderView, point_O: Array, settings: LeaderSettings) -> Array:
    """The leader's force for one view of the load, (3,) N, world; its vertical part is zero.

    Args:
        point_O: the point that is pulled, (3,) m, in the load's frame O.
    """
    arm_W = rotate(np.array(view.quat_wxyz), point_O)
    velocity = np.array(view.linear_velocity) + np.cross(np.array(view.angular_velocity), arm_W)
    planar = bounded_pull(
        np.array(settings.target_m(view.time_ns)) - np.array(view.position[:2]),
        velocity[:2],
        settings.stiffness_N_m,
        settings.damping_Ns_m,
        settings.force_max_N,
    )
    return np.array([planar[0], planar[1], 0.0])


def run_leader(link: Link, settings: LeaderSettings) -> str:
    """Join, pull at every view until the run ends, and return why it ended.

    Raises:
        NotWelcome, AgentError: not let in, nobody there, the simulator is gone, or the load has no such point.
    """
    keys = Keys(settings.run)
    pid, host = here()
    session = AgentSession(
        link, keys.leader, keys.sim_alive, Hello("leader", settings.run, "leader", "", "", pid, host)
    )
    try:
        welcome = session.join(settings.join_timeout_s, settings.wait_s)
        while True:
            try:
                lead(session, settings, welcome)
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


def lead(session: AgentSession, settings: LeaderSettings, welcome: Welcome) -> NoReturn:
    """Pull at every view that is newer than all before. Raises as :func:`run_leader`."""
    if settings.point not in welcome.points:
        session.leave()
        raise AgentError(
            f"leader: the load has no point {settings.point!r}; expected one of {', '.join(sorted(welcome.points))}"
        )
    point_O = np.array(welcome.points[settings.point])
    settings = replace(settings, force_max_N=min(settings.force_max_N, welcome.force_max_N))
    on_the_way = "".join(f" {stop.goal_m} until {stop.until_s:g} s, then" for stop in settings.stops)
    log.info("leader: joined, pulling %s towards%s %s", settings.point, on_the_way, settings.goal_m)

    newest = -1

    def answer(view: LeaderView) -> LeaderForce:
        nonlocal newest
        if view.tick <= newest:
            raise Refused(Reason.STALE, "tick", view.tick, f"more than {newest}")
        newest = view.tick
        force = pull(view, point_O, settings)
        return LeaderForce(view.tick, session.lease, settings.point, tuple(force.tolist()))

    while True:
        if welcome.clock != "real-time":
            session.answer_each(LeaderView, answer)
            continue
        view = session.receive_newest(1.0)
        if isinstance(view, LeaderView):
            try:
                session.send(answer(view))
            except Refused as refusal:
                session.refuse(refusal)
