"""Kinematics and dynamics of a serial arm with turning joints: everything that a torque law needs of the model.

Spatial vectors are [linear; angular] in the axes of the base frame B and taken at its origin, so that nothing has to be
transformed on the way down. Numbers or symbols (agents/tracing.py) alike; Pinocchio and MuJoCo are the references that
a test holds all of it to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Link:
    """One joint and the body that it turns."""

    p: Array
    """Where the joint's frame sits in that of the joint before, (3,) m."""
    R: Array
    """And how it is turned there, (3, 3), with the joint at zero."""
    axis: Array
    """The joint's axis in its own frame, (3,) unit vector."""
    mass: float
    com: Array
    """Centre of mass, (3,) m in the joint's frame."""
    inertia: Array
    """About the centre of mass, (3, 3) kg m^2 in the joint's frame."""
    rotor_inertia: float
    """Of the drive, as the joint feels it, kg m^2."""


@dataclass(frozen=True, slots=True)
class Chain:
    """An arm from its base to its tool centre E."""

    links: tuple[Link, ...]
    p_tool: Array
    """Where E sits in the last joint's frame, (3,) m."""
    R_tool: Array
    """And how it is turned there, (3, 3)."""
    gravity: Array
    """(3,) m/s^2 in B."""


@dataclass(frozen=True, slots=True)
class ChainTerms:
    """The model at one state; fields as in :class:`agents.arm_model.ArmSnapshot`."""

    M: Array
    C: Array
    g: Array
    J: Array
    Jdot: Array
    p_BE: Array
    R_BE: Array


def chain_terms(chain: Chain, q: Array, qd: Array) -> ChainTerms:
    """All terms at joint positions q, (n,) rad, and velocities qd, (n,) rad/s, in one pass out and one back.

    M by composite bodies (Featherstone 2008, section 6.2); C by the composite factorisation of Echeandia and Wensing
    2021 (Numerical methods to compute the Coriolis matrix and Christoffel symbols), which keeps Mdot = C + C^T.
    """
    n = len(chain.links)
    p, R, v = np.zeros(3), np.eye(3), np.zeros(6)
    S, Sdot, origins, I_c, B_c = [], [], [], [], []
    for link, q_i, qd_i in zip(chain.links, q, qd, strict=True):
        p, R = p + R @ link.p, R @ link.R @ turned(link.axis, q_i)
        axis = R @ link.axis
        S_i = np.concatenate([cross(p, axis), axis])
        v = v + S_i * qd_i
        inertia = spatial_inertia(link.mass, p + R @ link.com, R @ link.inertia @ R.T)
        S.append(S_i)
        Sdot.append(motion_cross(v) @ S_i)
        origins.append(p)
        I_c.append(inertia)
        B_c.append(coriolis_factor(inertia, v))
    p_BE, R_BE = p + R @ chain.p_tool, R @ chain.R_tool

    M, C, g = np.zeros((n, n), dtype=p.dtype), np.zeros((n, n), dtype=p.dtype), np.zeros(n, dtype=p.dtype)
    for j in reversed(range(n)):
        if j + 1 < n:  # bodies beyond a joint move with it
            I_c[j], B_c[j] = I_c[j] + I_c[j + 1], B_c[j] + B_c[j + 1]
        moved, turning, back = I_c[j] @ S[j], I_c[j] @ Sdot[j] + B_c[j] @ S[j], B_c[j].T @ S[j]
        for i in range(j + 1):
            M[i, j] = M[j, i] = S[i] @ moved
            C[i, j] = S[i] @ turning
            C[j, i] = Sdot[i] @ moved + S[i] @ back
        M[j, j] = M[j, j] + chain.links[j].rotor_inertia
        C[j, j] = S[j] @ turning
        g[j] = -(moved[:3] @ chain.gravity)

    v_E = v[:3] + cross(v[3:], p_BE)
    J = np.stack([at_point(S_i, p_BE) for S_i in S], axis=1)
    rates = [np.concatenate([at_point(d, p_BE)[:3] + cross(s[3:], v_E), d[3:]]) for s, d in zip(S, Sdot, strict=True)]
    return ChainTerms(M, C, g, J, np.stack(rates, axis=1), p_BE, R_BE)


def at_point(V: Array, p: Array) -> Array:
    """A spatial motion [v; w] given at the origin, taken at the point p, (6,): v + w x p."""
    return np.concatenate([V[:3] + cross(V[3:], p), V[3:]])


def cross(a: Array, b: Array) -> Array:
    """a x b, (3,)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def skew(a: Array) -> Array:
    """The matrix of ``a x``, (3, 3)."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def turned(axis: Array, angle: float) -> Array:
    """Rotation about a unit axis, (3, 3): I + sin K + (1 - cos) K^2 with K = ``axis x`` (Rodrigues)."""
    K = skew(axis)
    R: Array = np.eye(3) + K * np.sin(angle) + (K @ K) * (1.0 - np.cos(angle))
    return R


def spatial_inertia(mass: float, c: Array, I_com: Array) -> Array:
    """Inertia of a body at the origin, (6, 6).

    Args:
        c: its centre of mass, (3,) m.
        I_com: its inertia about that, (3, 3) kg m^2; both in B's axes.
    """
    h = skew(c) * mass
    return np.vstack([np.hstack([mass * np.eye(3), -h]), np.hstack([h, I_com - h @ skew(c)])])


def motion_cross(V: Array) -> Array:
    """The matrix of ``V x`` on motions, (6, 6)."""
    v, w = skew(V[:3]), skew(V[3:])
    return np.vstack([np.hstack([w, v]), np.hstack([np.zeros((3, 3)), w])])


def coriolis_factor(inertia: Array, V: Array) -> Array:
    """B of one body, (6, 6), with B V = V x* (I V): half of (V x*) I - I (V x) + the matrix of ``. x* (I V)``."""
    A = inertia @ motion_cross(V)  # and (V x*) = -(V x)^T
    h = inertia @ V
    f, m = skew(h[:3]), skew(h[3:])
    by_momentum = np.vstack([np.hstack([np.zeros((3, 3)), -f]), np.hstack([-f, -m])])
    return 0.5 * (by_momentum - A.T - A)


def inverse_of_inertia(M: Array) -> Array:
    """M^-1, (n, n), of a symmetric positive definite M, by M = L D L^T: no pivoting, so symbols will do."""
    n = len(M)
    L, d = np.eye(n, dtype=M.dtype), np.zeros(n, dtype=M.dtype)
    for j in range(n):
        d[j] = M[j, j] - (L[j, :j] * L[j, :j]) @ d[:j]
        for i in range(j + 1, n):
            L[i, j] = (M[i, j] - (L[i, :j] * L[j, :j]) @ d[:j]) / d[j]
    back = np.eye(n, dtype=M.dtype)  # L^-1
    for i in range(n):
        for j in range(i):
            back[i, j] = -(L[i, j:i] @ back[j:i, j])
    inverse = np.zeros((n, n), dtype=M.dtype)
    for i in range(n):
        for j in range(i + 1):
            inverse[i, j] = inverse[j, i] = (back[i:, i] / d[i:]) @ back[i:, j]
    return inverse
