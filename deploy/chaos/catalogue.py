"""The faults that storms and the matrix draw: each with its target and the ranges of its times and strengths.

A row is drawn into one event of a scenario, or two (a kill and the start that follows). Kinds of events that have no
row here get one by themselves, with the strengths that are their defaults: see :func:`faults`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args, get_origin

import numpy as np

from sim_server.scenario_events import EVENT_KINDS

Event = dict[str, Any]
Draws = np.random.Generator
Target = Literal["arm", "agent", "leader", "load"]

DIGITS = 3
"""Of drawn times and strengths: a schedule shall be read by people, and a tick is a millisecond."""


@dataclass(frozen=True, slots=True)
class Span:
    """Where a number is drawn from, evenly."""

    low: float
    high: float

    def draw(self, draws: Draws) -> float:
        return round(float(draws.uniform(self.low, self.high)), DIGITS)


@dataclass(frozen=True, slots=True)
class Fault:
    """One row."""

    name: str
    kind: str
    """Of the event."""
    target: Target
    for_s: Span | None = None
    strengths: Mapping[str, Span] = field(default_factory=dict)
    vectors: Mapping[str, Span] = field(default_factory=dict)
    """Lengths of vectors whose direction is drawn in the plane; of torques, about the vertical, to either side."""
    counts: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Whole numbers, from the first to the second."""
    choices: Mapping[str, Sequence[str]] = field(default_factory=dict)
    another_arm: str = ""
    """The key that gets the name of an arm that is not struck."""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    then: tuple[str, Span] | None = None
    """A second event of the same target, so much later."""
    ends: bool = False
    """What it strikes does not carry on as before: no other fault that needs it can be relied on to take effect."""

    alone: bool = False
    """Not for storms, unless it is asked for by its name."""

    def draw(self, draws: Draws, arms: Sequence[str], window_s: Span) -> list[Event]:
        """Its events, in order of time."""
        event: Event = {"at_s": window_s.draw(draws), "kind": self.kind}
        if self.target in ("arm", "agent"):
            event[self.target] = str(draws.choice(list(arms)))
        elif self.target == "leader":
            event["agent"] = "leader"
        event |= self.fixed
        if self.for_s is not None:
            event["for_s"] = self.for_s.draw(draws)
        event |= {key: span.draw(draws) for key, span in self.strengths.items()}
        event |= {key: _vector(key, span, draws) for key, span in self.vectors.items()}
        event |= {key: int(draws.integers(low, high, endpoint=True)) for key, (low, high) in self.counts.items()}
        event |= {key: str(draws.choice(list(words))) for key, words in self.choices.items()}
        if self.another_arm:
            event[self.another_arm] = str(draws.choice([arm for arm in arms if arm != event.get("arm")] or list(arms)))
        if self.then is None:
            return [event]
        kind, after_s = self.then
        second: Event = {"at_s": round(event["at_s"] + after_s.draw(draws), DIGITS), "kind": kind}
        return [event, second | {key: event[key] for key in ("agent", "arm") if key in event}]


def _vector(key: str, length: Span, draws: Draws) -> list[float]:
    size, angle = length.draw(draws), float(draws.uniform(0.0, 2.0 * np.pi))
    if "torque" in key:
        return [0.0, 0.0, size if np.sin(angle) >= 0 else -size]
    return [round(size * float(np.cos(angle)), DIGITS), round(size * float(np.sin(angle)), DIGITS), 0.0]


PUSH_S = Span(0.3, 2.0)
LOAD = {"point": "centre_of_mass"}


MESSAGES_S = Span(0.5, 3.0)
DIRECTIONS = {"direction": ("to", "from")}


def _message(kind: str, **ranges: Any) -> Fault:
    """A fault of one arm's messages, its states or its commands."""
    return Fault(kind, kind, "arm", for_s=MESSAGES_S, choices=DIRECTIONS, **ranges)


def _leader_message(kind: str, **ranges: Any) -> Fault:
    """A fault of the leader's messages, its views or its pulls. Storms are drawn without: they stay what they were."""
    leader = {"arm": "leader"}
    return Fault(
        f"leader-{kind}", kind, "load", for_s=MESSAGES_S, choices=DIRECTIONS, fixed=leader, alone=True, **ranges
    )


def _body(name: str, kind: str, **ranges: Any) -> Fault:
    """A physical fault of one robot."""
    return Fault(name, kind, "arm", for_s=Span(0.5, 3.0), **ranges)


OFTEN = {"probability": Span(0.05, 0.5)}
ANY_JOINT = {"joint": (1, 7)}
ANY_CHANNEL = {"channel": ("q", "qd", "tau", "wrench")}

ROWS: tuple[Fault, ...] = (
    Fault("kill", "kill", "agent", ends=True),
    Fault("kill-start", "kill", "agent", then=("start", Span(0.3, 2.0)), ends=True),
    Fault("stop", "stop", "agent", ends=True),
    # Shorter than the 20 missed ticks at which an arm is lost.
    Fault("stop-continue", "stop", "agent", then=("continue", Span(0.002, 0.018))),
    Fault("leave", "leave", "agent", ends=True),
    Fault("hang", "hang", "agent", ends=True),
    Fault(
        "restart_storm",
        "restart_storm",
        "agent",
        strengths={"every_s": Span(0.3, 0.8)},
        counts={"times": (2, 4)},
        ends=True,
    ),
    # In lock-step it costs wall time alone.
    Fault("slow", "slow", "agent", strengths={"share_percent": Span(40, 80)}, then=("continue", Span(0.2, 1.0))),
    # Nobody may be stopped or leaving then, and what the dead simulator's connections carried is not known: the audit
    # of such a run is unknown.
    Fault("sim_kill", "sim_kill", "load", alone=True),
    # Wall time of Zenoh's own reconnecting; storms are drawn without: they stay what they were.
    Fault("disconnect", "disconnect", "agent", ends=True, alone=True),
    Fault("disconnect-reconnect", "disconnect", "agent", then=("reconnect", Span(0.3, 2.0)), ends=True, alone=True),
    Fault("leader-kill", "kill", "leader", ends=True),
    Fault("leader-kill-start", "kill", "leader", then=("start", Span(0.3, 2.0)), ends=True),
    Fault("leader-stop", "stop", "leader", ends=True),
    Fault("fail_grasp", "fail_grasp", "arm", for_s=Span(0.3, 2.0), strengths={"force_N": Span(5.0, 40.0)}, ends=True),
    Fault("push-hand", "push", "arm", PUSH_S, vectors={"force_N": Span(10.0, 80.0)}),
    Fault("push-hand-smooth", "push", "arm", PUSH_S, vectors={"force_N": Span(10.0, 80.0)}, fixed={"shape": "smooth"}),
    Fault("push-hand-abrupt", "push", "arm", PUSH_S, vectors={"force_N": Span(10.0, 80.0)}, fixed={"shape": "abrupt"}),
    Fault("push-load", "push", "load", PUSH_S, vectors={"force_N": Span(10.0, 120.0)}, fixed=LOAD),
    Fault("bump-load", "push", "load", Span(0.02, 0.1), vectors={"force_N": Span(100.0, 500.0)}, fixed=LOAD),
    Fault("twist-load", "push", "load", PUSH_S, vectors={"torque_Nm": Span(5.0, 40.0)}, fixed=LOAD),
    Fault("grasp_slip", "grasp_slip", "arm", ends=True),
    _message("delay", counts={"delay_ticks": (1, 10)}),
    _message("jitter", counts={"jitter_ticks": (1, 8)}),
    _message("loss", strengths=OFTEN),
    _message("burst_loss", strengths={"probability": Span(0.01, 0.05)}, counts={"burst_ticks": (5, 19)}),
    _message("duplicate", strengths=OFTEN),
    _message("reorder", strengths=OFTEN),
    _message("stale", counts={"age_ticks": (2, 10)}),
    _message("truncate", strengths=OFTEN),
    _message("bit_flip", strengths=OFTEN, counts={"bits": (1, 4)}),
    _message("nan", strengths=OFTEN),
    _message("wrong_arm", strengths=OFTEN, another_arm="name"),
    _leader_message("delay", strengths=OFTEN, counts={"delay_ticks": (1, 30)}),
    _leader_message("loss", strengths=OFTEN),
    _leader_message("bit_flip", strengths=OFTEN, counts={"bits": (1, 4)}),
    _leader_message("nan", strengths=OFTEN),
    _body("joint_stuck", "joint_stuck", counts=ANY_JOINT),
    _body("torque_loss", "torque_loss", counts=ANY_JOINT, strengths={"factor": Span(0.0, 0.8)}),
    _body("torque_saturation", "torque_saturation", counts=ANY_JOINT, strengths={"limit_Nm": Span(2.0, 20.0)}),
    _body("sensor_bias-position", "sensor_bias", counts=ANY_JOINT, strengths={"position_rad": Span(0.002, 0.02)}),
    _body("sensor_bias-wrench", "sensor_bias", strengths={"wrench_N": Span(2.0, 20.0)}),
    _body("sensor_noise", "sensor_noise", strengths={"position_rad": Span(1e-3, 5e-3), "torque_Nm": Span(0.1, 1.0)}),
    _body("sensor_dropout", "sensor_dropout", choices=ANY_CHANNEL, strengths=OFTEN),
    _body("sensor_frozen", "sensor_frozen", choices=ANY_CHANNEL),
    _body("wrist_dead", "wrist_dead"),
    _body("wheel_slip", "wheel_slip", strengths={"factor": Span(0.0, 0.7)}),
    _body("wheel_stuck", "wheel_stuck", strengths={"friction_N": Span(50.0, 400.0)}),
    _body("floor_step", "floor_step", strengths={"height_mm": Span(2.0, 20.0)}),
    Fault("added_mass", "added_mass", "load", Span(0.5, 3.0), {"mass_kg": Span(1.0, 10.0)}),
)
"""The rows with stated ranges; those whose kind there is not are left out."""

WEAK_ENDS: Mapping[str, float] = {"factor": 1.0, "limit_Nm": 87.0, "share_percent": 100.0}
"""Where a strength does nothing any more, if that is not at zero: all of a torque or of the time, the largest of
an arm's limits."""

NOT_DRAWN = ("start", "continue", "reconnect", "join", "bump")
"""Kinds that undo a fault, that need a world of their own, or that are another word for a kind above."""


def faults() -> tuple[Fault, ...]:
    """All rows: those above, and one for every other kind of event that there is, with its default strengths."""
    stated = tuple(row for row in ROWS if row.kind in EVENT_KINDS)
    others = EVENT_KINDS.keys() - {row.kind for row in stated} - set(NOT_DRAWN)
    return stated + tuple(_by_its_keys(kind) for kind in EVENT_KINDS if kind in others)


def _by_its_keys(kind: str) -> Fault:
    """A row for a kind that this file does not know, by the keys of its model: whom it strikes, and what it must say.

    What is no word out of several, and has no default, cannot be drawn so: then every draw is refused, and a test says
    that the kind needs a row.
    """
    keys = EVENT_KINDS[kind].model_fields
    target: Target = "arm" if "arm" in keys else "agent" if "agent" in keys else "load"
    words = {
        key: get_args(info.annotation)
        for key, info in keys.items()
        if key != "kind" and info.is_required() and get_origin(info.annotation) is Literal
    }
    return Fault(kind, kind, target, for_s=Span(0.3, 2.0) if "for_s" in keys else None, choices=words)


def named(names: Sequence[str]) -> tuple[Fault, ...]:
    """The rows of these names; all without any. Raises ValueError with what there is."""
    known = {row.name: row for row in faults()}
    for name in names:
        if name not in known:
            raise ValueError(f"got {name!r}, expected one of {', '.join(known)}")
    return tuple(known[name] for name in dict.fromkeys(names)) if names else tuple(known.values())
