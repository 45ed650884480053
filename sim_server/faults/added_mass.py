"""Mass that is put onto the load while it is carried: a point mass, fixed to it, with its weight and its inertia."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from sim_server.faults.event import Fault, LoadPlace
from sim_server.faults.physical import Array, PhysicalEffect, PhysicalEvent
from sim_server.snapshot import Snapshot

if TYPE_CHECKING:
    from sim_server.world import World


class AddedMass(PhysicalEvent):
    """A point mass at a point of the load, from one step to the next, at the load's own velocity there."""

    kind: Literal["added_mass"]
    arm: None = None
    """It is the load's."""
    mass_kg: Annotated[float, Field(strict=True, gt=0, le=1000)] = 5.0
    point: LoadPlace = "centre"
    """``centre_of_mass``: of the load as it is built."""


class AddedMassEffect(PhysicalEffect):
    shapes = changes_inertia = True
    event: AddedMass
    _is_kg = 0.0
    _off_m = 0.0

    def shape(self, world: World, elapsed_s: float) -> None:
        from sim_server.scene import quat_wxyz, rotation_of  # not above: it knows the scenario, which knows all faults

        point = world.load_com if self.event.point == "centre_of_mass" else world.load_points[self.event.point]
        model, body = world.model, world.load_body
        R = rotation_of(model.body_iquat[body])
        I = R @ np.diag(model.body_inertia[body]) @ R.T
        mass, com, I = with_point_mass(
            float(model.body_mass[body]), model.body_ipos[body], I, self.event.mass_kg, point
        )
        principal, axes = np.linalg.eigh(I)
        axes[:, 2] *= np.sign(np.linalg.det(axes))  # right-handed
        model.body_mass[body], model.body_ipos[body] = mass, com
        model.body_inertia[body], model.body_iquat[body] = principal, quat_wxyz(axes)

    def watch(self, world: World, tick: int) -> None:
        self._is_kg = float(world.model.body_mass[world.load_body])
        self._off_m = float(np.linalg.norm(world.model.body_ipos[world.load_body] - world.load_com))

    @property
    def count(self) -> str:
        if not self._is_kg:
            return ""
        return f"the load weighs {self._is_kg:.4g} kg, its centre of mass {1e3 * self._off_m:.3g} mm off"

    def state(self) -> Snapshot:
        return {"is_kg": self._is_kg, "off_m": self._off_m}

    def restore(self, saved: Snapshot) -> None:
        self._is_kg, self._off_m = float(saved["is_kg"]), float(saved["off_m"])


def with_point_mass(mass: float, com: Array, I: Array, added: float, point: Array) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia about that of a body with a point mass, by Steiner's rule.

    Args:
        mass, com, I: of the body: kg, (3,) m, (3, 3) kg m^2 about its own centre of mass, in its axes.
        added, point: kg, (3,) m.
    """
    whole = mass + added
    middle = (mass * com + added * point) / whole
    both = I.copy()
    for m, r in ((mass, com - middle), (added, point - middle)):
        both += m * (r @ r * np.eye(3) - np.outer(r, r))
    return whole, middle, both


FAULTS = (
    Fault(
        "added_mass",
        "physical",
        AddedMass,
        "a point mass is fixed to the load at `point`: mass, inertia and weight of the model change",
        "what the load weighs, how far its centre of mass has moved",
    ),
)
EFFECTS: Mapping[type[PhysicalEvent], type[PhysicalEffect]] = {AddedMass: AddedMassEffect}
