"""The messages, one frozen class each. What a follower may feel is exactly :class:`State`, and nothing else.

msgspec's structures, not dataclasses: those make a frozen object field by field in Python, at every message of a tick.

Numbers are SI; joint vectors have the arm's number of joints n (7 for the Panda). Simulated time is an integer.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

MAX_JOINTS = 16
MAX_INT = 2**63 - 1

Vector = tuple[float, ...]
Joints = Annotated[Vector, Meta(min_length=1, max_length=MAX_JOINTS)]
Three = Annotated[Vector, Meta(min_length=3, max_length=3)]
Four = Annotated[Vector, Meta(min_length=4, max_length=4)]
Six = Annotated[Vector, Meta(min_length=6, max_length=6)]
Count = Annotated[int, Meta(ge=0, le=MAX_INT)]
Name = Annotated[str, Meta(max_length=40)]


class Hello(Struct, frozen=True, gc=False):
    """An agent asks to be let in (query on its ``hello`` key)."""

    role: Literal["follower", "leader"]
    run: str
    name: str
    """The arm's name, or ``leader``."""
    arm_model: str
    """Name of the arm model that the agent computes with; empty for the leader."""
    digest: str
    """SHA-256 (hex) of that model's description file; empty for the leader."""
    pid: int
    host: str


class Welcome(Struct, frozen=True, gc=False):
    """The simulator lets an agent in (reply to :class:`Hello`)."""

    lease: int
    """Goes into every command; a later instance of the same agent gets a higher one and the old is refused."""
    clock: Literal["lock-step", "real-time"]
    control_period_ns: int
    """Simulated time from one of this agent's messages to the next."""
    points: dict[str, Vector]
    """Leader only: named points of the load, (3,) m, in the load's frame O. Empty for followers."""
    force_max_N: float
    """Leader only: the largest pull that is not refused. Zero for followers."""
    carry_height_m: float
    """Followers only: how high above the arm's own base frame the hand carries, pointing straight down. Zero for the
    leader."""
    strut: Vector
    """Followers whose hand is empty only: where the strut is that it shall take, told this once: (7,) position in m
    and ``quat_wxyz`` of the hand that grasps it, in the base frame B as it stands now. Zeros for all others."""


class Refusal(Struct, frozen=True, gc=False):
    """The simulator does not let an agent in, and why (reply to :class:`Hello`)."""

    reason: str
    text: str


class State(Struct, frozen=True, gc=False):
    """What one arm feels at one tick: its own joints and its own wrist. All a follower ever gets."""

    arm: Name
    tick: Count
    time_ns: Count
    q: Joints
    """Joint positions, (n,) rad."""
    qd: Joints
    """Joint velocities, (n,) rad/s."""
    tau: Joints
    """Measured joint torques, (n,) N m."""
    wrench: Six
    """Wrist wrench [force; torque], (6,) N and N m: what the arm exerts on the hand, in the wrist frame."""
    grip_m: float
    """How far the fingers of its hand are open, m."""
    odometry: Six
    """Only while the hand is empty: the base's x, y, yaw since its welcome or since the hand opened, whichever was
    later, in the frame in which it stood then, and its velocity in its present frame B: (6,) m, rad and m/s, rad/s.
    Else zeros: who carries feels no place."""


class Command(Struct, frozen=True, gc=False):
    """What one agent wants at one tick. From ``stiffness`` on it is a report: recorded, never obeyed."""

    arm: Name
    tick: Count
    """The tick of the state that this answers."""
    lease: Count
    torque: Joints
    """Joint torques, (n,) N m, gravity included."""
    base_force: Three
    """(3,) force x, y in N and yaw torque in N m on the mobile base, in the base frame B."""
    grip_m: float
    """How far the fingers shall open, m: 0 closes them on whatever is between them."""
    stiffness: Joints
    """(n,) present joint stiffness, N m/rad."""
    residual_W: float
    """Power that the law put into the hand beyond what its springs gave back and its dampers took."""
    step_ns: Count
    """Wall time that the controller's step took."""


class LeaderView(Struct, frozen=True, gc=False):
    """What the leader sees of the load, in the world frame."""

    tick: Count
    time_ns: Count
    position: Three
    """(3,) m, of the load's frame O."""
    quat_wxyz: Four
    """(4,) orientation of O in the world, w first."""
    linear_velocity: Three
    """(3,) m/s, of the origin of O."""
    angular_velocity: Three
    """(3,) rad/s, world frame."""


class LeaderForce(Struct, frozen=True, gc=False):
    """The leader's pull."""

    tick: Count
    lease: Count
    point: Name
    """Name of the point of the load that the force acts at."""
    force: Three
    """(3,) N, world frame."""


class Leaving(Struct, frozen=True, gc=False):
    """An agent begins to leave: it stays in and answers on while it puts down what it carries, and says goodbye when it
    stands clear (query on its ``hello`` key; the reply is the same message, or a :class:`Refusal`)."""

    name: str
    lease: int


class Goodbye(Struct, frozen=True, gc=False):
    """An agent leaves in order (query on its ``hello`` key; the reply is the same message, or a :class:`Refusal`)."""

    name: str
    lease: int


class End(Struct, frozen=True, gc=False):
    """The run is over, or this agent's part in it (on the agent's ``state`` key)."""

    kind: Literal["over", "lost"]
    """``over``: nothing went wrong with this agent. ``lost``: it did not answer in time and is out."""
    reason: str


class Progress(Struct, frozen=True, gc=False):
    """How the run goes, for observers."""

    phase: Literal["waiting", "running", "ended"]
    waiting_for: str
    tick: int
    ticks: int
    time_s: float
    real_time_factor: float
    tilt_deg: float
    goal_distance_m: float
    """Negative when there is no goal."""
    missed_ticks: int
    """Ticks that arms have missed so far, all arms together."""
    age_max_ticks: int
    """Real time: the oldest command that an arm has obeyed so far, in ticks from the state it answers."""


class Row(Struct, frozen=True, gc=False):
    """All that is recorded of one tick, for observers."""

    tick: int
    tick_ns: int
    """Wall time that the tick took."""
    arms: str
    """Names of the arms that are there, with spaces between."""
    struts: str
    """Numbers of their struts, from 1, likewise."""
    values: bytes
    """float64, little-endian: the columns of the trace from ``load.position`` on, of these arms, in order."""


class Event(Struct, frozen=True, gc=False):
    """A line of events.jsonl, for observers; and one more, ``judged``, that says the verdict."""

    tick: int
    time_s: float
    kind: str
    details: str
    """What else the line says: a JSON object."""


class Order(Struct, frozen=True, gc=False):
    """An order of the operator."""

    verb: Literal["stop", "join"]
    strut: int
    """``join``: number of the strut that a new robot shall take, from 1. Else 0."""


class Deed(Struct, frozen=True, gc=False):
    """Something that the scenario wants done to a process: asked of the launcher, who alone owns the processes."""

    number: int
    """Of this deed in the run; the report carries it back."""
    verb: Literal["kill", "stop", "continue", "start", "leave", "hang", "slow", "disconnect", "reconnect"]
    agent: str


class Done(Struct, frozen=True, gc=False):
    """The launcher's report that a deed is done (the kernel says so), or why it cannot be."""

    number: int
    problem: str
    """Empty when it is done."""


Message = (
    Hello
    | Welcome
    | Refusal
    | State
    | Command
    | LeaderView
    | LeaderForce
    | Leaving
    | Goodbye
    | End
    | Progress
    | Row
    | Event
    | Order
    | Deed
    | Done
)
