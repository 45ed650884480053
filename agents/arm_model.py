"""The arm as the agent believes it to be: the one door to Pinocchio.

The description (wire/arms) is the agent's own copy of the data sheet; the simulator's arm differs from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from agents.equations.chain import Chain, Link
from agents.errors import AgentError
from wire.arms import arm_digest, arm_path

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ArmSnapshot:
    """All terms of the model at one state, computed in one pass; whoever holds one knows that the work is done.

    B is the arm's base frame, E the tool centre; n joints. Jacobians are those of E at its own origin, expressed in B
    (Pinocchio's LOCAL_WORLD_ALIGNED), rows [v; w].
    """

    q: Array
    """(n,) rad."""
    qd: Array
    """(n,) rad/s."""
    M: Array
    """Joint inertia, (n, n), armature included, symmetric."""
    M_inv: Array
    """Its inverse, (n, n)."""
    C: Array
    """Coriolis matrix, (n, n), with Mdot = C + C^T."""
    g: Array
    """Gravity torque, (n,) N m."""
    J: Array
    """(6, n)."""
    Jdot: Array
    """(6, n)."""
    p_BE: Array
    """(3,) m."""
    R_BE: Array
    """(3, 3)."""


@dataclass(frozen=True, slots=True)
class Hand:
    """What hangs on the wrist's sensor of an arm that holds nothing."""

    mass: float
    p_EC: Array
    """Its centre of mass C, (3,) m in E."""
    R_EW: Array
    """The wrist's frame in E, (3, 3)."""


class ArmModel:
    """Kinematics and dynamics of one arm on a level base.

    Raises:
        wire.arms.UnknownArm: there is no description of that name.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.digest = arm_digest(name)
        self._model: Any = pin.buildModelFromMJCF(str(arm_path(name)))
        self._data: Any = self._model.createData()
        if not self._model.existFrame("tcp"):
            raise AgentError(f"arm model {name}: no site named 'tcp' in its description")
        self._tcp = self._model.getFrameId("tcp")
        self.joints: int = self._model.nv
        self.chain = self._read_chain()
        """What the model is made of, for who works its terms out in a way of his own (agents/equations/chain.py)."""
        self._fold = np.triu(np.ones((self.joints, self.joints)), 1) + 0.5 * np.eye(self.joints)

    def snapshot(self, q: Array, qd: Array) -> ArmSnapshot:
        """All terms at joint positions q, (n,) rad, and velocities qd, (n,) rad/s. The arrays are the caller's own."""
        model, data, tcp = self._model, self._data, self._tcp
        C = pin.computeCoriolisMatrix(model, data, q, qd).copy()  # and the Jacobians with their rates
        g = pin.computeGeneralizedGravity(model, data, q).copy()
        M = self._symmetric(pin.crba(model, data, q))
        M_inv = self._symmetric(pin.computeMinverse(model, data, q))
        placement = pin.updateFramePlacement(model, data, tcp)
        return ArmSnapshot(
            q=q,
            qd=qd,
            M=M,
            M_inv=M_inv,
            C=C,
            g=g,
            J=pin.getFrameJacobian(model, data, tcp, pin.LOCAL_WORLD_ALIGNED),
            Jdot=pin.getFrameJacobianTimeVariation(model, data, tcp, pin.LOCAL_WORLD_ALIGNED),
            p_BE=placement.translation.copy(),
            R_BE=placement.rotation.copy(),
        )

    def hand(self, q: Array) -> tuple[Array, Array, Array]:
        """Of :meth:`snapshot` at rest the hand's part alone: p_BE (3,) m, R_BE (3, 3) and J (6, n)."""
        model, data, tcp = self._model, self._data, self._tcp
        pin.computeJointJacobians(model, data, q)
        placement = pin.updateFramePlacement(model, data, tcp)
        J: Array = pin.getFrameJacobian(model, data, tcp, pin.LOCAL_WORLD_ALIGNED)
        return placement.translation.copy(), placement.rotation.copy(), J

    def gravity(self, q: Array) -> Array:
        """Gravity torque at q, (n,) N m."""
        g: Array = pin.computeGeneralizedGravity(self._model, self._data, q).copy()
        return g

    def _read_chain(self) -> Chain:
        """Raises :class:`AgentError` if the arm is no chain of turning joints."""
        model, tool = self._model, self._model.frames[self._tcp]
        links = []
        for index in range(1, model.njoints):
            axis, placement, body = (
                np.array(self._data.joints[index].S).ravel(),
                model.jointPlacements[index],
                model.inertias[index],
            )
            if model.parents[index] != index - 1 or len(axis) != 6 or axis[:3].any():
                raise AgentError(f"arm model {self.name}: {model.names[index]}: expected a chain of turning joints")
            links.append(
                Link(
                    p=placement.translation.copy(),
                    R=placement.rotation.copy(),
                    axis=axis[3:],
                    mass=body.mass,
                    com=body.lever.copy(),
                    inertia=body.inertia.copy(),
                    rotor_inertia=float(model.armature[index - 1]),
                )
            )
        if tool.parentJoint != model.njoints - 1:
            raise AgentError(f"arm model {self.name}: the site 'tcp' is not on the last link")
        return Chain(
            tuple(links), tool.placement.translation.copy(), tool.placement.rotation.copy(), model.gravity.linear.copy()
        )

    def beyond_the_wrist(self) -> Hand:
        """The hand as its description has it. Raises :class:`AgentError` if it has no wrist."""
        model = self._model
        if not model.existFrame("wrist"):
            raise AgentError(f"arm model {self.name}: no site named 'wrist' in its description")
        tool, wrist = model.frames[self._tcp], model.frames[model.getFrameId("wrist")]
        parts = [
            (frame.inertia.mass, frame.placement.act(frame.inertia.lever))
            for frame in model.frames
            if frame.parentJoint == tool.parentJoint and frame.type == pin.FrameType.FIXED_JOINT
        ]
        mass = sum(each for each, _ in parts)
        com = sum((each * place for each, place in parts), np.zeros(3)) / mass if mass else tool.placement.translation
        R_E = tool.placement.rotation.T
        return Hand(mass, R_E @ (com - tool.placement.translation), R_E @ wrist.placement.rotation)

    def _symmetric(self, filled_above: Array) -> Array:
        """The symmetric matrix of which Pinocchio fills the upper triangle only; always a copy."""
        half = self._fold * filled_above
        symmetric: Array = half + half.T
        return symmetric
