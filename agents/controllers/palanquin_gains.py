"""The gains of the preset `palanquin`: one set for all loads and teams. Each part of the law has its switch here."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from agents.controllers.reference import ReferenceGains

NotNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]


class PalanquinGains(ReferenceGains):
    """Gains in SI; the same for every scenario. docs/control-law.md has what each part is worth."""

    lift_stiffness_N_m: Positive = 8000.0
    """Least stiffness of the hand's height."""
    tilt_stiffness_Nm_rad: Positive = 600.0
    """Least stiffness of its roll and of its pitch."""
    stiffen: NotNegative = 1.0
    """How much is added to these at a large error, as a part of them. 0: the stiffness stays."""
    lift_soft_m: Positive = 0.005
    """Error of the height at which half of that is added."""
    tilt_soft_rad: Positive = 0.02
    """Likewise, of roll and pitch."""
    stiffness_rate_1_s: NotNegative = 10.0
    """Bound of the stiffness's relative rate, up and down. 0: no bound."""
    damping_ratio: NotNegative = 1.0
    """Of height, roll and pitch of the free arm, with the stiffness of the moment."""

    observer_rate_1_s: NotNegative = 10.0
    """How fast the observer follows what the arm feels of the load. 0: no observer."""
    observer_leak_1_s: Positive = 8.0
    """How fast it forgets. A load that stays sags by leak / (rate + leak) of what the spring alone would give; the less
    it sags, the more a hand that holds a millimetre too high takes from the others' load, or adds to it."""

    plane_stiffness_N_m: NotNegative = 40.0
    """Spring between hand and base in the plane: the brake. 0: nothing damps the plane but the leader."""
    plane_damping_Ns_m: NotNegative = 50.0
    """Damper beside it."""
    force_rate_1_s: NotNegative = 9.0
    """How fast the hand's force in the plane is brought to the wanted one, by the wrist's sensor. 0: not at all, and
    the joints' dry friction, which base and hand are locked by, pushes the load along."""
    force_leak_1_s: Positive = 1.0
    """How fast this correction is forgotten."""

    yaw_stiffness_Nm_rad: NotNegative = 150.0
    """Spring of the hand's yaw against the base."""
    yaw_damping_Nms_rad: NotNegative = 20.0
    """Damper beside it."""
    yaw_moment_max_Nm: Positive = 10.0
    """The most that the two ask of the wrist, whose last joint can do 12 N m."""
    base_yaw_hold: bool = True
    """The base's drive takes up the moment that the hand's force turns the base by."""
    base_yaw_stiffness_Nm_rad: NotNegative = 6.0
    """Base yaw follows the hand: drive's torque by angle; with 60 N m s/rad of resistance a tenth of it per second."""

    posture_stiffness_Nm_rad: NotNegative = 20.0
    """Of every joint towards its place at the start, in the self-motion alone."""
    posture_damping_Nms_rad: NotNegative = 5.0
    """Likewise."""
    wrist_yields: bool = True
    """A wrist joint at its limit gives up a moment about its own axis instead of pushing the hand sideways."""

    base_stiffness_N_m: NotNegative = 2000.0
    """K_m of eq. 16, the paper's."""
    base_damping_Ns_m: NotNegative = 20.0
    """B_m of eq. 16, the paper's."""
