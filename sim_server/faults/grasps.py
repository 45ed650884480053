"""Hands that do not hold any more: at once, or after a while in which they hold badly."""

from __future__ import annotations

from typing import Literal

from sim_server.faults.event import Event, Fault, NotNegative, Positive


class FailGrasp(Event):
    """A hand that holds badly for a while, with spurious forces drawn from the seed, and then slips off for good."""

    kind: Literal["fail_grasp"]
    arm: str
    for_s: Positive = 1.0
    force_N: NotNegative = 20.0
    """Spurious force between hand and load, one standard deviation per axis."""


class GraspSlip(Event):
    """A hand that lets go at once; its driver feels that it is empty and draws it back, whatever its agent commands."""

    kind: Literal["grasp_slip"]
    arm: str


FAULTS = (
    Fault(
        "fail_grasp",
        "physical",
        FailGrasp,
        "the hand holds badly: softly, with spurious forces drawn from the seed; then it slips off for good",
        "the weld is soft; again when the hand is open",
    ),
    Fault(
        "grasp_slip",
        "physical",
        GraspSlip,
        "the hand lets go at once, and its driver draws it back",
        "the weld is open: the hand holds nothing",
    ),
)
