"""What an arm's drives can do, read from its description: torque, torque rate, speed and range of every joint."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from xml.etree import ElementTree

from wire.arms import arm_path

TORQUE_RATE_NM_S = 1000.0
"""Largest rate of joint torque that the Panda's torque interface accepts (Franka Control Interface documentation)."""


@dataclass(frozen=True, slots=True)
class ArmLimits:
    """Limits of one arm, joint by joint; n joints."""

    torque_Nm: tuple[float, ...]
    """(n,) largest absolute joint torque."""
    position_rad: tuple[tuple[float, float], ...]
    """(n,) lowest and highest joint position."""
    torque_rate_Nm_s: float

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.torque_Nm)


@cache
def arm_limits(name: str) -> ArmLimits:
    """Limits of the arm ``name``. Raises :class:`wire.arms.UnknownArm`."""
    root = ElementTree.parse(arm_path(name)).getroot()
    classes = dict(_joint_classes(root.find("default"), {}))
    joints = [{**classes.get(joint.get("class", ""), {}), **joint.attrib} for joint in root.findall(".//body/joint")]
    return ArmLimits(
        torque_Nm=tuple(_pair(joint["actuatorfrcrange"])[1] for joint in joints),
        position_rad=tuple(_pair(joint["range"]) for joint in joints),
        torque_rate_Nm_s=TORQUE_RATE_NM_S,
    )


def _joint_classes(
    default: ElementTree.Element | None, inherited: dict[str, str]
) -> Iterator[tuple[str, dict[str, str]]]:
    """Every default class below ``default`` with the joint attributes that it gives, inherited ones included."""
    if default is None:
        return
    joint = default.find("joint")
    attributes = {**inherited, **(joint.attrib if joint is not None else {})}
    yield default.get("class", ""), attributes
    for child in default.findall("default"):
        yield from _joint_classes(child, attributes)


def _pair(text: str) -> tuple[float, float]:
    low, high = (float(part) for part in text.split())
    return low, high
