"""Events of a scenario file: what happens at a simulated time, to a process or in the simulated world.

Process events really happen to processes: the launcher sends the signal or starts the process, and the clock stands
until that is seen. Whether the events can happen so at all is checked before anything runs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

At = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]

LoadPlace = Literal["centre_of_mass", "centre", "front", "back", "left", "right"]

Verb = Literal["kill", "stop", "continue", "start", "leave"]


class _Event(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    at_s: At
    """Simulated time; the event takes effect before the tick of that time."""


class ProcessEvent(_Event):
    """A thing done to the process of an arm's agent or of the leader.

    ``kill``: SIGKILL. ``stop``: SIGSTOP. ``continue``: SIGCONT. ``leave``: SIGTERM, at which it puts down
    what it carries, drives clear and says goodbye.
    ``start``: a new process (an old one of that name that is still there is ended first).
    """

    kind: Verb
    agent: str
    """An arm's name, or ``leader``."""


class FailGrasp(_Event):
    """A hand that holds badly for a while, with spurious forces drawn from the seed, and then slips off for good."""

    kind: Literal["fail_grasp"]
    arm: str
    for_s: Positive = 1.0
    force_N: NotNegative = 20.0
    """Spurious force between hand and load, one standard deviation per axis."""


class Join(_Event):
    """A new robot comes: it stands outside at that time, drives to a free strut, takes hold, and carries on.

    Its world is built and its agent started before that, while the simulation goes on.
    """

    kind: Literal["join"]
    arm: Annotated[str, Field(pattern=r"^a[1-9][0-9]{0,2}$")]
    """A name that no arm of the scenario has, such as ``a5``."""
    strut: Annotated[int, Field(strict=True, ge=1)]
    """Number of the strut, from 1; arm ``ak`` of the team starts at strut k."""


class Push(_Event):
    """A disturbance from outside: a force and a torque on one arm's hand, or on the load, for a while.

    ``constant``: as given. ``smooth``: each component swings within what is given, sines of several periods with phases
    drawn from the seed, and comes and goes gently. ``abrupt``: each component jumps to values drawn within what is
    given, and stays there for times drawn from the seed. See :mod:`sim_server.push_shapes`.
    """

    kind: Literal["push"]
    arm: str | None = None
    """Whose hand, at the tool centre; or else"""
    point: LoadPlace | None = None
    """a point of the load."""
    for_s: Positive
    force_N: Vector3 = (0.0, 0.0, 0.0)
    """In the world's axes."""
    torque_Nm: Vector3 = (0.0, 0.0, 0.0)
    shape: Literal["constant", "smooth", "abrupt"] = "constant"
    period_s: Positive | None = None
    """``smooth``: of the slowest of its sines; 4 s if it is not given."""
    hold_s: Annotated[float, Field(strict=True, ge=0.001, allow_inf_nan=False)] | None = None
    """``abrupt``: mean time between two jumps; 0.5 s if it is not given."""


ScenarioEvent = Annotated[ProcessEvent | FailGrasp | Join | Push, Field(discriminator="kind")]
AnyEvent = ProcessEvent | FailGrasp | Join | Push

_FOLLOWS: Mapping[Verb, tuple[Collection[str], str]] = {
    "kill": (("running", "stopped", "leaving"), "gone"),
    "stop": (("running", "leaving"), "stopped"),
    "continue": (("stopped",), "running"),
    "leave": (("running",), "leaving"),
    "start": (("gone", "stopped", "leaving", "running again"), "running"),
}
"""Which process a verb can be done to, and what that process is then. One that is leaving may have gone meanwhile."""


def check_events(
    events: Sequence[AnyEvent], arms: Collection[str], has_leader: bool, end_s: float, struts: int = 16
) -> None:
    """Raise ``ValueError`` with ``key: what is wrong`` for the first event that cannot happen."""
    agents = [*arms, "leader"] if has_leader else list(arms)
    process = dict.fromkeys(agents, "running")
    slipped: set[str] = set()
    held = {strut: arm for strut, arm in enumerate(arms, start=1)}
    """Struts whose holders have not been disturbed yet."""
    for number, event in sorted(enumerate(events), key=lambda each: each[1].at_s):
        where = f"events.{number}"
        if event.at_s >= end_s:
            raise ValueError(f"{where}.at_s: {event.at_s:g} s is not before the run's end at {end_s:g} s")
        if isinstance(event, Join):
            if event.arm in process:
                raise ValueError(
                    f"{where}.arm: there is an arm {event.arm} already; a newcomer needs a name of its own"
                )
            if event.strut > struts:
                raise ValueError(f"{where}.strut: {event.strut}, but the load has {struts} struts")
            if event.strut in held:
                raise ValueError(
                    f"{where}.strut: {event.strut} is taken by {held[event.strut]}, and no event before frees it; "
                    "expected a free one"
                )
            process[event.arm], held[event.strut] = "running", event.arm
            continue
        affected = event.arm if isinstance(event, FailGrasp) else getattr(event, "agent", None)
        held = {strut: arm for strut, arm in held.items() if arm != affected}
        if isinstance(event, FailGrasp):
            if event.arm not in process or event.arm == "leader":
                raise ValueError(f"{where}.arm: no arm {event.arm!r}; expected one of {', '.join(arms)}")
            if event.arm in slipped:
                raise ValueError(f"{where}.arm: the grasp of {event.arm} has failed before, and for good")
            slipped.add(event.arm)
            continue
        if isinstance(event, Push):
            _check_push(event, where, [name for name in process if name != "leader"], end_s)
            continue
        if event.agent not in process:
            raise ValueError(f"{where}.agent: no agent {event.agent!r}; expected one of {', '.join(process)}")
        before, after = _FOLLOWS[event.kind]
        if process[event.agent] not in before and not ("running" in before and process[event.agent] == "running again"):
            raise ValueError(
                f"{where}.kind: {event.agent} is {process[event.agent]} at {event.at_s:g} s, by the events before; "
                f"{event.kind!r} expects it to be {' or '.join(before)}"
            )
        process[event.agent] = "running again" if event.kind == "continue" else after


def _check_push(push: Push, where: str, arms: Collection[str], end_s: float) -> None:
    if (push.arm is None) == (push.point is None):
        got = "neither `arm` nor `point`" if push.arm is None else "both `arm` and `point`"
        raise ValueError(f"{where}.arm: a push is on one arm's hand or on one point of the load; got {got}")
    if push.arm is not None and push.arm not in arms:
        raise ValueError(f"{where}.arm: no arm {push.arm!r} then; expected one of {', '.join(arms)}")
    if not (any(push.force_N) or any(push.torque_Nm)):
        raise ValueError(f"{where}.force_N: nothing pushes: expected a `force_N` or a `torque_Nm` that is not zero")
    if push.at_s + push.for_s >= end_s:
        raise ValueError(
            f"{where}.for_s: the push ends at {push.at_s + push.for_s:g} s, not before the run's end at {end_s:g} s"
        )
    for key, value, shape in (("period_s", push.period_s, "smooth"), ("hold_s", push.hold_s, "abrupt")):
        if value is not None and push.shape != shape:
            raise ValueError(f"{where}.{key}: means nothing for shape {push.shape!r}; expected shape {shape!r}")


def in_order(events: Sequence[AnyEvent], period_ms: int) -> list[tuple[int, AnyEvent]]:
    """Events with the tick before which they happen, in time; those of one time in the order of the file."""
    return sorted(
        ((round(event.at_s * 1000 / period_ms), event) for event in events),
        key=lambda each: each[0],
    )
