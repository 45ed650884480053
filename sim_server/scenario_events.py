"""Events of a scenario file: what happens at a simulated time, to a process, a message, or in the simulated world.

Most are faults (:mod:`sim_server.faults`). Process events really happen to processes: the launcher sends the signal or
starts the process, and the clock stands until that is seen. Whether the events can happen so at all is checked before
anything runs.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from pydantic import Field

from sim_server.faults.event import Event, Lasting
from sim_server.faults.grasps import FailGrasp, GraspSlip
from sim_server.faults.message import MessageEvent
from sim_server.faults.physical import PhysicalEvent
from sim_server.faults.processes import AnyVerb, RestartStorm, SimKill, ToProcess
from sim_server.faults.pushes import Push
from sim_server.faults.registry import FAULTS


class Join(Event):
    """A new robot comes: it stands outside at that time, drives to a free strut, takes hold, and carries on.

    Its world is built and its agent started before that, while the simulation goes on.
    """

    kind: Literal["join"]
    arm: Annotated[str, Field(pattern=r"^a[1-9][0-9]{0,2}$")]
    """A name that no arm of the scenario has, such as ``a5``."""
    strut: Annotated[int, Field(strict=True, ge=1)]
    """Number of the strut, from 1; arm ``ak`` of the team starts at strut k."""


AnyEvent = ToProcess | RestartStorm | SimKill | FailGrasp | GraspSlip | Join | Push | MessageEvent | PhysicalEvent
Whole = ToProcess | SimKill | FailGrasp | GraspSlip | Join | Push | MessageEvent | PhysicalEvent
"""Those that do not consist of others."""

SETTINGS: tuple[type[Event], ...] = tuple(dict.fromkeys((*(fault.settings for fault in FAULTS), Join)))
"""Every kind of table that ``[[events]]`` may have."""
EVENT_KINDS: Mapping[str, type[Event]] = {
    kind: settings for settings in SETTINGS for kind in get_args(settings.model_fields["kind"].annotation)
}
"""The same by the word for it."""

if TYPE_CHECKING:
    ScenarioEvent = AnyEvent
else:
    ScenarioEvent = Annotated[reduce(or_, SETTINGS), Field(discriminator="kind")]

_FOLLOWS: Mapping[AnyVerb, tuple[Collection[str], str]] = {
    "kill": (("running", "stopped", "leaving", "hung", "slow", "cut off"), "gone"),
    "stop": (("running", "leaving"), "stopped"),
    "hang": (("running", "leaving"), "hung"),
    "slow": (("running",), "slow"),
    "continue": (("stopped", "hung", "slow"), "running"),
    "leave": (("running", "slow"), "leaving"),
    "disconnect": (("running",), "cut off"),
    "reconnect": (("cut off",), "running"),
    "start": (("gone", "stopped", "leaving", "running again", "hung", "cut off"), "running"),
}
"""Which process a verb can be done to, and what that process is then. One that is leaving may have gone meanwhile."""


def check_events(
    events: Sequence[AnyEvent],
    arms: Collection[str],
    has_leader: bool,
    end_s: float,
    struts: int = 16,
    checkpoint_s: float = 1.0,
) -> None:
    """Raise ``ValueError`` with ``key: what is wrong`` for the first event that cannot happen."""
    agents = [*arms, "leader"] if has_leader else list(arms)
    process = dict.fromkeys(agents, "running")
    slipped: set[str] = set()
    held = {strut: arm for strut, arm in enumerate(arms, start=1)}
    """Struts whose holders have not been disturbed yet."""
    for number, event in sorted(_parts(events), key=lambda each: each[1].at_s):
        where = f"events.{number}"
        if event.at_s >= end_s:
            raise ValueError(f"{where}.at_s: {event.at_s:g} s is not before the run's end at {end_s:g} s")
        if isinstance(event, SimKill):
            _check_sim_kill(event, where, events, process, checkpoint_s)
            continue
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
        affected = getattr(event, "agent", None)
        if isinstance(event, FailGrasp | GraspSlip):
            affected = event.arm
        held = {strut: arm for strut, arm in held.items() if arm != affected}
        there = [name for name in process if name != "leader"]
        if isinstance(event, Push):
            _check_push(event, where, there, end_s)
            continue
        if isinstance(event, FailGrasp | GraspSlip):
            _check_arm(event.arm, where, there)
            if event.arm in slipped:
                raise ValueError(f"{where}.arm: the grasp of {event.arm} has failed before, and for good")
            slipped.add(event.arm)
            continue
        if isinstance(event, Lasting):
            _check_lasting(event, where, list(process) if isinstance(event, MessageEvent) else there, end_s)
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


def _check_sim_kill(
    event: SimKill, where: str, events: Sequence[AnyEvent], process: Mapping[str, str], checkpoint_s: float
) -> None:
    """Everybody who was in at the last checkpoint must be there to greet the next simulator, as they were then."""
    if not checkpoint_s:
        raise ValueError(f"{where}.kind: 'sim_kill', but record.checkpoint_s = 0: there is nothing to go on from")
    if any(isinstance(each, Join) for each in events):
        raise ValueError(f"{where}.kind: 'sim_kill' in a scenario in which robots come: expected one or the other")
    for agent, is_ in process.items():
        if is_ in ("stopped", "hung", "leaving", "cut off"):
            raise ValueError(f"{where}.at_s: {agent} is {is_} at {event.at_s:g} s and cannot greet the next simulator")
    since_s = checkpoint_s * math.floor(event.at_s / checkpoint_s + 1e-9)
    for number, each in _parts(events):
        if isinstance(each, ToProcess) and since_s <= each.at_s <= event.at_s:
            raise ValueError(
                f"{where}.at_s: events.{number} happens to {each.agent} between the last checkpoint, at {since_s:g} s, "
                f"and the simulator's death at {event.at_s:g} s; expected none, since those ticks are run again"
            )


def _check_arm(arm: str, where: str, arms: Collection[str]) -> None:
    if arm not in arms:
        raise ValueError(f"{where}.arm: no arm {arm!r} then; expected one of {', '.join(arms)}")


def _check_lasting(event: Lasting, where: str, arms: Collection[str], end_s: float) -> None:
    if event.arm is not None:
        _check_arm(event.arm, where, arms)
    if event.for_s is not None and event.at_s + event.for_s >= end_s:
        raise ValueError(
            f"{where}.for_s: it ends at {event.at_s + event.for_s:g} s, not before the run's end at {end_s:g} s; "
            "leave it out for a fault that goes on until then"
        )
    if problem := event.problem():
        raise ValueError(f"{where}.{problem[0]}: {problem[1]}")


def _check_push(push: Push, where: str, arms: Collection[str], end_s: float) -> None:
    if (push.arm is None) == (push.point is None):
        got = "neither `arm` nor `point`" if push.arm is None else "both `arm` and `point`"
        raise ValueError(f"{where}.arm: a push is on one arm's hand or on one point of the load; got {got}")
    if push.arm is not None:
        _check_arm(push.arm, where, arms)
    if not (any(push.force_N) or any(push.torque_Nm)):
        raise ValueError(f"{where}.force_N: nothing pushes: expected a `force_N` or a `torque_Nm` that is not zero")
    if push.at_s + push.for_s >= end_s:
        raise ValueError(
            f"{where}.for_s: the push ends at {push.at_s + push.for_s:g} s, not before the run's end at {end_s:g} s"
        )
    for key, value, shape in (("period_s", push.period_s, "smooth"), ("hold_s", push.hold_s, "abrupt")):
        if value is not None and push.shape != shape:
            raise ValueError(f"{where}.{key}: means nothing for shape {push.shape!r}; expected shape {shape!r}")


def _parts(events: Sequence[AnyEvent]) -> Iterator[tuple[int, Whole]]:
    """Every event with its number in the file; one that consists of several by these."""
    for number, event in enumerate(events):
        for part in event.parts() if isinstance(event, RestartStorm) else [event]:
            yield number, part


def in_order(events: Sequence[AnyEvent], period_ms: int) -> list[tuple[int, Whole]]:
    """Events with the tick before which they happen, in time; those of one time in the order of the file."""
    return sorted(
        ((round(event.at_s * 1000 / period_ms), event) for _, event in _parts(events)),
        key=lambda each: each[0],
    )
