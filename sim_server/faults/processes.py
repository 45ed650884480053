"""What is done to processes: the launcher does it, and the kernel or the simulator's own eyes say that it was done.

Nothing of it is in the agent: the process that is hit is the shipped one.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sim_server.faults.event import Event, Fault, Positive

Verb = Literal["kill", "stop", "continue", "start", "leave", "hang", "disconnect", "reconnect"]
AnyVerb = Literal[Verb, "slow"]
"""What the launcher can be asked for."""


class ToProcess(Event):
    """A thing done to the process of an arm's agent or of the leader."""

    kind: AnyVerb
    agent: str
    """An arm's name, or ``leader``."""


class ProcessEvent(ToProcess):
    """``kill``: SIGKILL. ``stop``: SIGSTOP. ``continue``: SIGCONT, or the end of a ``hang`` or a ``slow``.

    ``leave``: SIGTERM, at which it puts down what it carries, drives clear and says goodbye. ``start``: a new process
    (an old one of that name that is still there is ended first). ``hang``: its control loop stands still, and all its
    other threads go on. ``disconnect``: its link to the simulator is cut. ``reconnect``: the link is there again.
    """

    kind: Verb


class Slow(ToProcess):
    """A process that gets a part of the time only: it is stopped for the rest of every 20 ms of wall time."""

    kind: Literal["slow"]
    share_percent: Annotated[float, Field(strict=True, ge=5, le=95)] = 20.0
    """In which it runs, if there is a core for it."""


class RestartStorm(Event):
    """A process that is killed and started again, several times: each of them is an event of its own."""

    kind: Literal["restart_storm"]
    agent: str
    times: Annotated[int, Field(strict=True, ge=1, le=100)] = 5
    every_s: Positive = 0.5
    """From one kill to the next; it is started in the middle between them."""

    def parts(self) -> list[ToProcess]:
        """The kills and starts, in order."""
        kinds: tuple[Literal["kill", "start"], ...] = ("kill", "start")
        return [
            ProcessEvent(kind=kind, agent=self.agent, at_s=round(self.at_s + (k + half) * self.every_s, 9))
            for k in range(self.times)
            for kind, half in zip(kinds, (0.0, 0.5), strict=True)
        ]


class SimKill(Event):
    """The simulator is killed; the launcher starts it again from its last checkpoint, and all agents greet it anew."""

    kind: Literal["sim_kill"]


FAULTS = (
    Fault("kill", "process", ProcessEvent, "SIGKILL to the agent's process", "its sign of life is gone"),
    Fault("stop", "process", ProcessEvent, "SIGSTOP to all of it", "the kernel has stopped all of it"),
    Fault(
        "hang",
        "process",
        ProcessEvent,
        "the thread that works out its answers stands still, its others go on; nobody tells the clock",
        "the kernel has stopped that thread, and the sign of life is still there",
    ),
    Fault(
        "slow",
        "process",
        Slow,
        "it runs in `share_percent` of every 20 ms of wall time, and is stopped for the rest",
        "the kernel has stopped it and let it go on, again and again",
    ),
    Fault(
        "continue",
        "process",
        ProcessEvent,
        "SIGCONT, or the end of a `hang` or a `slow`",
        "the kernel says that it goes on",
    ),
    Fault(
        "disconnect",
        "process",
        ProcessEvent,
        "its link to the simulator is cut, and stays so; it lives on, and waits for the simulator",
        "its sign of life is gone",
    ),
    Fault(
        "reconnect",
        "process",
        ProcessEvent,
        "the link is there again, and the agent greets anew",
        "it has greeted and its links are up",
    ),
    Fault(
        "start",
        "process",
        ProcessEvent,
        "a new process; an old one that is still there is ended first",
        "it has greeted and its links are up",
    ),
    Fault(
        "restart_storm",
        "process",
        RestartStorm,
        "`times` kills, `every_s` apart, and a start between two of them",
        "each kill and each start, as above",
    ),
    Fault("leave", "process", ProcessEvent, "SIGTERM: the agent leaves in order", "it has said goodbye and is gone"),
    Fault(
        "sim_kill",
        "process",
        SimKill,
        "SIGKILL to the simulator; the launcher starts it again, from its last checkpoint",
        "another simulator goes on, from which tick",
    ),
)
