"""Forces and torques from outside. Where they act and how they go: :mod:`sim_server.disturbances`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sim_server.faults.event import Event, Fault, LoadPlace, Positive, Vector3


class Push(Event):
    """A disturbance from outside: a force and a torque on one arm's hand, or on the load, for a while.

    ``constant``: as given. ``smooth``: each component swings within what is given, sines of several periods with phases
    drawn from the seed, and comes and goes gently. ``abrupt``: each component jumps to values drawn within what is
    given, and stays there for times drawn from the seed. See :mod:`sim_server.push_shapes`.
    """

    kind: Literal["push", "bump"]
    """``bump`` is another word for the same, for a push that is meant to be short and hard."""
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


FAULTS = tuple(
    Fault(
        kind,
        "physical",
        Push,
        "something pushes an arm's hand or the load" + (": another word for `push`" if kind == "bump" else ""),
        "force and torque that act, in N and N m; again when it has ended",
    )
    for kind in ("push", "bump")
)
