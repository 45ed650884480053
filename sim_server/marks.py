"""How arms, forces and the goal are drawn, alike in every picture, film and viewer. No physics engine here."""

from __future__ import annotations

from sim_server.parts import Colour
from sim_server.robots import ACCENTS
from sim_server.scenario import arm_number

LEADER_FORCE, PUSH_ON_LOAD = "leader", "load"
"""Names of the forces on the load."""
WRIST, PUSH = "wrist", "push"
"""The others are called ``a1/wrist``, what an arm exerts on its hand, and ``a1/push``, what pushes the hand."""

ARROW_M_PER_N = 0.0125
SHORTEST_ARROW_N = 2.0
"""A force below this has no arrow: a shaft shorter than it is thick says nothing."""
LEADER_COLOUR: Colour = (0.08, 0.08, 0.08)
PUSH_COLOUR: Colour = (0.50, 0.10, 0.65)
GOAL_COLOUR: Colour = (0.80, 0.10, 0.10)
GOAL_RADIUS_M = 0.10
"""A load within it has arrived (``arrival_time_s``)."""


def arm_colour(arm: str) -> Colour:
    """The colour of an arm, as on its base."""
    return ACCENTS[arm_number(arm) % len(ACCENTS)]


def force_colour(name: str) -> Colour:
    """The colour of a force: the leader's, an arm's own, or that of what pushes."""
    if name == LEADER_FORCE:
        return LEADER_COLOUR
    arm, _, what = name.partition("/")
    return arm_colour(arm) if what == WRIST else PUSH_COLOUR


def eight_bit(colour: Colour) -> tuple[int, int, int]:
    """A colour in 0 to 255."""
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue
