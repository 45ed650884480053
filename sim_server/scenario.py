"""A scenario: the whole of what is carried, by whom, where to, and what counts as success.

Scenarios are TOML files. Those in ``sim_server/scenarios`` ship with the package; any path works as well. Every key
has a unit in its name, every number is checked, unknown keys are refused. ``extends = "transport"`` starts from
another scenario and changes only what the file names.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from sim_server.scenario_events import Join, ScenarioEvent, check_events

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Vector2 = tuple[Finite, Finite]
Mass = Annotated[float, Field(strict=True, ge=1e-3, le=1e4, allow_inf_nan=False)]
Size = Annotated[float, Field(strict=True, ge=1e-2, le=100, allow_inf_nan=False)]
Offset = Annotated[float, Field(strict=True, ge=-100, le=100, allow_inf_nan=False)]

REAL_TIME_PERIODS_MS = (1, 2, 4)

FIXED_REACH_M = 0.2
"""How far arms whose bases are fixed can be pulled, and still have some way to their limits."""

WhenLost = Literal["limp", "brake", "release"]
LoadPoint = Literal["centre", "front", "back", "left", "right"]


def arm_number(name: str) -> int:
    """Number of an arm, from 0: ``a1`` is 0. What is drawn for an arm, and its colour, depend on it."""
    return int(name[1:]) - 1


class Section(BaseModel):
    """A table of a scenario file: immutable, unknown keys refused. Numbers are strict: no text, no true or false."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Clock(Section):
    """How simulated time relates to the agents' answers."""

    mode: Literal["lock-step", "real-time"] = "lock-step"
    """``lock-step``: simulated time waits for every answer. ``real-time``: it follows the wall clock."""
    control_period_ms: Annotated[int, Field(strict=True, ge=1, le=20)] = 1
    """Time from one tick to the next; the control law runs once per tick."""
    answer_timeout_s: Positive = 5.0
    """Wall time after which lock-step goes on without an agent that has not answered: that tick is missed."""
    start_timeout_s: Positive = 60.0
    """Wall time that the simulator waits for the agents before tick 0."""


class Team(Section):
    """The bearers: how many, with which arm, standing where, under which law."""

    count: Annotated[int, Field(strict=True, ge=1, le=16)]
    arm: str = "panda"
    controller: str = "paper"
    """A controller's name or ``module:Class``."""
    gains: dict[str, Any] = {}
    """The controller's settings; the agents check them."""
    handover_s: NotNegative = 1.0
    """Time over which a follower's torque passes from what its arm carried at take-over to what the law wants."""
    missed_ticks_until_lost: Annotated[int, Field(strict=True, ge=1)] = 20
    """Ticks without an answer, in a row, after which an arm is lost (as on the arm's own interface)."""
    when_lost: WhenLost = "limp"
    """What the motor driver does with an arm that nobody commands any more. ``limp``: gravity compensated and damped,
    still holding; its base rolls freely. ``brake``: joints and base held where they are, still holding. ``release``:
    the hand opens, the arm draws up and back, the base stops."""
    leave_s: NotNegative = 2.0
    """Time over which the motor driver lets an arm's share down after its agent's goodbye."""


class Load(Section):
    """The rigid load. Its frame O sits at the middle of its footprint on the level of its lowest point, x forward."""

    shape: Literal["table", "crate", "block"] = "table"
    """``table``: top, four legs, struts under the top. ``crate``: a closed box, struts around its waist. ``block``: a
    solid box that one hand holds at its middle."""
    size_m: tuple[Size, Size, Size] = (1.6, 0.9, 0.75)
    """Length along x, width along y, height along z."""
    mass_kg: Mass = 20.0
    centre_of_mass_offset_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """Shift of the centre of mass from where the shape puts it, in O."""
    struts: Annotated[int, Field(strict=True, ge=1, le=16)] = 4
    """Places to grasp, laid out evenly around the rim."""


class Stop(Section):
    """A place on the way to the goal."""

    goal_m: Vector2
    """Where the load's frame O is pulled meanwhile, in the world's plane."""
    until_s: Positive
    """Simulated time at which the leader turns to the next stop, or to the goal."""


class Leader(Section):
    """The one who knows the goal: a bounded proportional pull with damping at a named point of the load."""

    goal_m: Vector2
    """Where the load's frame O shall end, in the world's plane; the load starts at (0, 0)."""
    force_max_N: Positive = 40.0
    stiffness_N_m: NotNegative = 100.0
    damping_Ns_m: NotNegative = 320.0
    point: LoadPoint = "front"
    period_ms: Annotated[int, Field(strict=True, ge=1)] = 10
    """The leader looks and pulls once in this time."""
    stops: tuple[Stop, ...] = ()
    """Where the load is pulled before, in this order. The metrics know the goal alone."""
    waypoints: tuple[Vector2, ...] = ()
    """The same, but each until the load has come near, however long that takes; not together with stops."""
    near_m: Positive = 0.15
    """From where on a waypoint counts as reached, from the load's frame O, in the plane."""
    by: Literal["law", "keyboard", "gamepad"] = "law"
    """Who says where to pull: the law above, or a person at this device of the machine on which the run is started."""

    @model_serializer(mode="wrap")
    def _without_what_is_not_used(self, whole: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """As it was before there were waypoints and persons, where there are none: a scenario that has not changed
        keeps its digest, by which reports know their runs."""
        content: dict[str, Any] = whole(self)
        unused = [] if self.waypoints else ["waypoints", "near_m"]
        return {
            key: value for key, value in content.items() if key not in (unused if self.by != "law" else [*unused, "by"])
        }


class Base(Section):
    """The mobile base: planar, force-driven, pushed by whatever pushes the arm."""

    fixed: bool = False
    """Bolted to the floor: an arm on a stand."""
    mass_kg: Mass = 80.0
    yaw_inertia_kg_m2: Positive = 5.0
    rolling_resistance_Ns_m: NotNegative = 600.0
    yaw_resistance_Nms_rad: NotNegative = 60.0
    force_max_N: Positive = 1000.0
    torque_max_Nm: Positive = 200.0


class Plant(Section):
    """The world, and how it differs from what the agents believe. All differences are drawn from the seed."""

    physics_step_ms: Annotated[int, Field(strict=True, ge=1, le=10)] = 1
    link_mass_error: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.03
    """Each link's mass and inertia is off by a factor drawn from 1 +- this (uniform)."""
    joint_damping_Nms_rad: NotNegative = 0.5
    """Viscous joint friction that the agents' model does not have; each joint draws 0.5 to 1.5 times this."""
    joint_friction_Nm: NotNegative = 0.2
    """Dry joint friction that the agents' model does not have; each joint draws 0.5 to 1.5 times this."""
    position_noise_rad: NotNegative = 1e-5
    velocity_noise_rad_s: NotNegative = 1e-3
    torque_noise_Nm: NotNegative = 0.05
    wrench_noise_N: NotNegative = 0.2
    wrench_noise_Nm: NotNegative = 0.02
    difference_scale: NotNegative = 1.0
    """Factor on all the differences and noises above: 0 for a world that is as the agents believe, 3 for one that is
    three times as different. The draws stay the same."""
    start_offset_m: Annotated[float, Field(strict=True, ge=0, le=0.05, allow_inf_nan=False)] = 0.0
    """The load with its team, and each base under its hand, start up to this far off along x and y (uniform)."""
    start_yaw_rad: Annotated[float, Field(strict=True, ge=0, le=0.2, allow_inf_nan=False)] = 0.0
    """And turned by up to this."""
    delay_ticks: Annotated[int, Field(strict=True, ge=0, le=100)] = 0
    """Ticks between an agent's answer and the motor driver that obeys it."""

    @property
    def scaled(self) -> Plant:
        """The same with its factor worked in."""
        return self.model_copy(update={name: getattr(self, name) * self.difference_scale for name in SCALED})


SCALED = (
    "link_mass_error",
    "joint_damping_Nms_rad",
    "joint_friction_Nm",
    "position_noise_rad",
    "velocity_noise_rad_s",
    "torque_noise_Nm",
    "wrench_noise_N",
    "wrench_noise_Nm",
)
"""What ``plant.difference_scale`` scales."""


class Record(Section):
    """What goes into the run folder while the run goes on."""

    every_ticks: Annotated[int, Field(strict=True, ge=1)] = 5
    """A row of trace.parquet per so many ticks."""
    checkpoint_s: NotNegative = 1.0
    """Simulated time between two checkpoints, from which a simulator that was killed can go on; 0: none."""


class Bound(Section):
    """The bounds of one metric; at least one of the two."""

    min: Finite | None = None
    max: Finite | None = None

    @model_validator(mode="after")
    def _some_bound(self) -> Bound:
        if self.min is None and self.max is None:
            raise ValueError("a bound needs `min`, `max` or both")
        return self


class Scenario(Section):
    """One scenario file, checked."""

    description: str
    seed: Annotated[int, Field(strict=True, ge=0)] = 1
    duration_s: Positive = 25.0
    clock: Clock = Clock()
    team: Team
    load: Load = Load()
    leader: Leader | None = None
    base: Base = Base()
    plant: Plant = Plant()
    record: Record = Record()
    events: tuple[ScenarioEvent, ...] = ()
    expect: dict[str, Bound] = {}

    @field_validator("duration_s")
    @classmethod
    def _not_endless(cls, value: float) -> float:
        if value > 86_400:
            raise ValueError("longer than a day")
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        if self.team.count > self.load.struts:
            raise ValueError(
                f"team.count: {self.team.count} arms but load.struts = {self.load.struts}: each arm needs a strut"
            )
        if self.clock.control_period_ms % self.plant.physics_step_ms:
            raise ValueError(
                f"clock.control_period_ms: {self.clock.control_period_ms} is not a multiple of "
                f"plant.physics_step_ms = {self.plant.physics_step_ms}"
            )
        if self.clock.mode == "real-time" and self.clock.control_period_ms not in REAL_TIME_PERIODS_MS:
            raise ValueError(
                f"clock.control_period_ms: {self.clock.control_period_ms} in real time, where it is 1, 2 or 4"
            )
        if self.leader and self.leader.period_ms % self.clock.control_period_ms:
            raise ValueError(
                f"leader.period_ms: {self.leader.period_ms} is not a multiple of "
                f"clock.control_period_ms = {self.clock.control_period_ms}"
            )
        if self.plant.scaled.link_mass_error >= 1:
            raise ValueError(
                f"plant.difference_scale: {self.plant.difference_scale:g} times link_mass_error = "
                f"{self.plant.link_mass_error:g} is {self.plant.scaled.link_mass_error:g}: expected less than 1, "
                "which is all of a mass"
            )
        if self.load.shape == "block" and self.load.struts != 1:
            raise ValueError(f"load.struts: {self.load.struts}, but one hand holds a block: expected 1")
        self._check_way()
        self._check_fixed()
        check_events(
            self.events,
            self.arms,
            self.leader is not None,
            self.duration_s,
            self.load.struts,
            self.record.checkpoint_s,
        )
        return self

    def _check_way(self) -> None:
        leader = self.leader
        if leader and leader.stops and leader.waypoints:
            raise ValueError("leader.waypoints: beside leader.stops: expected one of the two, places or times")
        if leader and leader.by != "law" and (leader.stops or leader.waypoints):
            raise ValueError(f"leader.by: {leader.by!r}, but leader.stops or waypoints say where to: both would lead")
        before_s = 0.0
        for number, stop in enumerate(self.leader.stops if self.leader else ()):
            where = f"leader.stops.{number}.until_s"
            if stop.until_s <= before_s:
                raise ValueError(f"{where}: {stop.until_s:g} s is not after {before_s:g} s, when this stop begins")
            if stop.until_s >= self.duration_s:
                raise ValueError(f"{where}: {stop.until_s:g} s is not before the run's end at {self.duration_s:g} s")
            before_s = stop.until_s

    def _check_fixed(self) -> None:
        if not self.base.fixed:
            return
        for number, event in enumerate(self.events):
            if isinstance(event, Join):
                raise ValueError(
                    f"events.{number}.kind: 'join', but base.fixed = true: no robot can drive to its strut"
                )
            if event.kind in ("wheel_slip", "wheel_stuck", "floor_step"):
                raise ValueError(f"events.{number}.kind: {event.kind!r}, but base.fixed = true: it does not drive")
        leader = self.leader
        places = [*(stop.goal_m for stop in leader.stops), *leader.waypoints, leader.goal_m] if leader else []
        farthest = max((math.hypot(*place) for place in places), default=0.0)
        if farthest > FIXED_REACH_M:
            raise ValueError(
                f"leader.goal_m: {farthest:g} m from the start, but base.fixed = true: expected at most "
                f"{FIXED_REACH_M:g} m, which the arms reach without their bases, or no leader"
            )

    @property
    def ticks(self) -> int:
        """Number of control ticks of the whole run."""
        exact = self.duration_s * 1000 / self.clock.control_period_ms
        return math.ceil(round(exact, 6))  # 2.007 s are 2007 ticks of 1 ms, not 2008 by a bit of rounding

    def seconds(self, ticks: int) -> float:
        """Duration of a run of so many ticks."""
        return ticks * self.clock.control_period_ms / 1000

    @property
    def joining(self) -> tuple[str, ...]:
        """Names of the arms that come later, by its events."""
        return tuple(event.arm for event in self.events if isinstance(event, Join))

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms, ``a1`` to ``aN``; arm ``ak`` starts at strut k - 1."""
        return tuple(f"a{k}" for k in range(1, self.team.count + 1))
