"""The agent's arm model at random states within the joint limits, against MuJoCo, which shares no code with it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from agents.arm_model import ArmModel, ArmSnapshot
from wire.arms import UnknownArm, arm_path

Array = NDArray[np.float64]

ROUNDING = 1e-12
"""Two recursions over seven joints with numbers of the order of 1 to 10, each rounded to 2e-16."""
FORCE_ROUNDING = 1e-11
"""The same for torques, which are of the order of 100."""
H = 1e-5
"""Step of a central difference: cutting off costs H^2 = 1e-10 of the third derivative, rounding 2e-16 / H = 2e-11."""
DIFFERENCE = 1e-8
"""What a central difference with H may be off, for numbers up to 100."""


@dataclass(frozen=True)
class Witness:
    """The same terms by MuJoCo."""

    M: Array
    h: Array
    g: Array
    J: Array
    Jdot: Array
    p: Array
    R: Array


@cache
def by_mujoco() -> Any:
    return mujoco.MjModel.from_xml_path(str(arm_path("panda")))


def witness(q: Array, qd: Array) -> Witness:
    """M, C qd + g, g, J, Jdot, p_BE and R_BE of MuJoCo."""
    model = by_mujoco()
    data = mujoco.MjData(model)
    tcp = data.site("tcp")
    M, J, Jdot = np.zeros((7, 7)), np.zeros((6, 7)), np.zeros((6, 7))
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    g = data.qfrc_bias.copy()
    data.qvel[:] = qd
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    mujoco.mj_jacSite(model, data, J[:3], J[3:], tcp.id)
    mujoco.mj_jacDot(model, data, Jdot[:3], Jdot[3:], tcp.xpos, model.site_bodyid[tcp.id])
    return Witness(M, data.qfrc_bias.copy(), g, J, Jdot, tcp.xpos.copy(), tcp.xmat.reshape(3, 3).copy())


@cache
def arm() -> ArmModel:
    return ArmModel("panda")


def random_states() -> list[tuple[Array, Array]]:
    """Postures over the whole joint range, speeds up to each joint's limit (about 2 rad/s)."""
    low, high = by_mujoco().jnt_range.T
    rng = np.random.default_rng(20)
    return [(rng.uniform(low, high), rng.uniform(-2.0, 2.0, 7)) for _ in range(50)]


STATES = random_states()


def compared() -> list[tuple[ArmSnapshot, Witness]]:
    return [(arm().snapshot(q, qd), witness(q, qd)) for q, qd in STATES]


def test_inertia_and_its_inverse_are_mujocos() -> None:
    for ours, theirs in compared():
        np.testing.assert_allclose(ours.M, theirs.M, rtol=0, atol=ROUNDING)
        # Rotors of 0.1 kg m^2 on every joint keep the condition number of M below 100.
        np.testing.assert_allclose(ours.M_inv @ theirs.M, np.eye(7), rtol=0, atol=100 * ROUNDING)
        np.testing.assert_array_equal(ours.M, ours.M.T)
        np.testing.assert_array_equal(ours.M_inv, ours.M_inv.T)


def test_gravity_torque_is_mujocos() -> None:
    for ours, theirs in compared():
        np.testing.assert_allclose(ours.g, theirs.g, rtol=0, atol=FORCE_ROUNDING)


def test_coriolis_matrix_gives_mujocos_bias_force() -> None:
    for ours, theirs in compared():
        np.testing.assert_allclose(ours.C @ ours.qd + ours.g, theirs.h, rtol=0, atol=FORCE_ROUNDING)


def test_coriolis_matrix_is_the_one_that_keeps_energy() -> None:
    """Mdot - 2 C is skew, that is Mdot = C + C^T, with Mdot from differences of MuJoCo's M along the motion. (C qd
    alone does not say which C it is.)"""
    for q, qd in STATES[:20]:
        Mdot = (witness(q + H * qd, qd).M - witness(q - H * qd, qd).M) / (2 * H)
        C = arm().snapshot(q, qd).C
        assert np.abs(Mdot).max() > 0.1  # else the next line says nothing
        np.testing.assert_allclose(C + C.T, Mdot, rtol=0, atol=DIFFERENCE)


def test_hand_and_its_jacobians_are_mujocos_in_the_base_frame_at_the_tool_centre() -> None:
    for ours, theirs in compared():
        np.testing.assert_allclose(ours.p_BE, theirs.p, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(ours.R_BE, theirs.R, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(ours.J, theirs.J, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(ours.Jdot, theirs.Jdot, rtol=0, atol=10 * ROUNDING)  # speeds up to 2 rad/s in it


def test_jacobian_is_the_rate_of_the_pose_and_jdot_the_rate_of_the_jacobian() -> None:
    """Against differences: an error that both engines shared would show."""
    for q, qd in STATES[:20]:
        now = arm().snapshot(q, qd)
        after, before = arm().snapshot(q + H * qd, qd), arm().snapshot(q - H * qd, qd)
        v, w = np.split(now.J @ qd, 2)
        spin = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        np.testing.assert_allclose((after.p_BE - before.p_BE) / (2 * H), v, rtol=0, atol=DIFFERENCE)
        np.testing.assert_allclose((after.R_BE - before.R_BE) / (2 * H), spin @ now.R_BE, rtol=0, atol=DIFFERENCE)
        np.testing.assert_allclose((after.J - before.J) / (2 * H), now.Jdot, rtol=0, atol=DIFFERENCE)


def test_the_parts_are_those_of_a_snapshot_at_rest() -> None:
    for q, _ in STATES:
        whole = arm().snapshot(q, np.zeros(len(q)))
        p, R, J = arm().hand(q)
        np.testing.assert_array_equal(p, whole.p_BE)
        np.testing.assert_array_equal(R, whole.R_BE)
        np.testing.assert_allclose(J, whole.J, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(arm().gravity(q), whole.g)


def test_a_snapshot_does_not_change_when_the_next_is_taken() -> None:
    (q, qd), (q2, qd2) = STATES[:2]
    first = arm().snapshot(q, qd)
    names = [field.name for field in fields(first)]
    kept = {name: np.array(getattr(first, name)) for name in names}
    second = arm().snapshot(q2, qd2)
    for name in names:
        np.testing.assert_array_equal(getattr(first, name), kept[name], err_msg=name)
        assert not np.array_equal(getattr(second, name), kept[name]), name


def test_one_state_gives_one_answer_whatever_came_before() -> None:
    (q, qd), (q2, qd2) = STATES[:2]
    alone = ArmModel("panda").snapshot(q, qd)
    arm().snapshot(q2, qd2)
    again = arm().snapshot(q, qd)
    for field in fields(alone):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(alone, field.name), err_msg=field.name)


def test_an_unknown_arm_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownArm, match="panda"):
        ArmModel("nobody")
