"""What all events of a scenario have in common, and the entry with which a fault introduces itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

At = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Probability = Annotated[float, Field(strict=True, gt=0, le=1)]
Count = Annotated[int, Field(strict=True, ge=1, le=1000)]
Joint = Annotated[int, Field(strict=True, ge=1, le=7)]
"""A joint's number, from 1; every arm that there is has seven."""
Vector3 = tuple[Finite, Finite, Finite]

LoadPlace = Literal["centre_of_mass", "centre", "front", "back", "left", "right"]
Family = Literal["process", "message", "physical"]


class Event(BaseModel):
    """What happens at a simulated time."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: str
    """Which of the events it is; a fault says which words it has."""
    at_s: At
    """Simulated time; the event takes effect before the tick of that time."""


class Lasting(Event):
    """What goes on for a while, with one arm or with the load."""

    for_s: Positive | None = None
    """How long; without it until the run's end."""
    arm: str | None = None

    def problem(self) -> tuple[str, str] | None:
        """The key at fault and what is wrong with it, if the settings do not fit each other."""
        return None


@dataclass(frozen=True, slots=True)
class Fault:
    """One row of docs/chaos.md: a kind of event that is a fault."""

    kind: str
    family: Family
    settings: type[Event]
    does: str
    """What happens."""
    proof: str
    """What is seen, and counted, when it has taken effect."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What has been seen of an event."""

    event: Event
    effect: str
    proves: bool = True
    """Whether that shows that the event took effect."""
