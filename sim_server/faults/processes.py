"""What is done to processes: the launcher does it, and the kernel or the simulator's own eyes say that it was done."""

from __future__ import annotations

from typing import Literal

from sim_server.faults.event import Event, Fault

Verb = Literal["kill", "stop", "continue", "start", "leave"]


class ProcessEvent(Event):
    """A thing done to the process of an arm's agent or of the leader.

    ``kill``: SIGKILL. ``stop``: SIGSTOP. ``continue``: SIGCONT. ``leave``: SIGTERM, at which it puts down
    what it carries, drives clear and says goodbye.
    ``start``: a new process (an old one of that name that is still there is ended first).
    """

    kind: Verb
    agent: str
    """An arm's name, or ``leader``."""


FAULTS = (
    Fault("kill", "process", ProcessEvent, "SIGKILL to the agent's process", "its sign of life is gone"),
    Fault("stop", "process", ProcessEvent, "SIGSTOP", "the kernel has stopped all of it"),
    Fault("continue", "process", ProcessEvent, "SIGCONT", "the kernel says that it goes on"),
    Fault(
        "start",
        "process",
        ProcessEvent,
        "a new process; an old one that is still there is ended first",
        "it has greeted and its links are up",
    ),
    Fault("leave", "process", ProcessEvent, "SIGTERM: the agent leaves in order", "it has said goodbye and is gone"),
)
