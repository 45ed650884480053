"""The Panda's description against the published robot and against itself, read by two engines that share no code."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from wire.arms import UnknownArm, arm_digest, arm_path, known_arms

REFERENCE = json.loads((Path(__file__).parent / "data" / "panda_reference.json").read_text())
ARMATURE = 0.1


class ByMujoco:
    """Terms of the arm as MuJoCo reads the file."""

    def __init__(self) -> None:
        self.model: Any = mujoco.MjModel.from_xml_path(str(arm_path("panda")))
        self.data: Any = mujoco.MjData(self.model)

    def terms(self, q: Any, qd: Any) -> dict[str, Any]:
        model, data = self.model, self.data
        data.qpos[:], data.qvel[:] = q, qd
        mujoco.mj_forward(model, data)
        M, J = np.zeros((7, 7)), np.zeros((6, 7))
        mujoco.mj_fullM(model, data, M)
        tcp = data.site("tcp")
        mujoco.mj_jacSite(model, data, J[:3], J[3:], tcp.id)
        return {"M": M, "h": data.qfrc_bias.copy(), "J": J, "p": tcp.xpos.copy(), "R": tcp.xmat.reshape(3, 3).copy()}


class ByPinocchio:
    """Terms of the arm as Pinocchio reads the file."""

    def __init__(self) -> None:
        self.model = pin.buildModelFromMJCF(str(arm_path("panda")))
        self.data = self.model.createData()

    def terms(self, q: Any, qd: Any) -> dict[str, Any]:
        model, data = self.model, self.data
        frame = model.getFrameId("tcp")
        M = np.triu(pin.crba(model, data, q))  # fills the upper triangle only
        h = pin.nonLinearEffects(model, data, q, qd).copy()
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(model, data, q)
        X = data.oMf[frame]
        return {"M": M + np.triu(M, 1).T, "h": h, "J": J, "p": X.translation.copy(), "R": X.rotation.copy()}


ENGINES: dict[str, type[ByMujoco | ByPinocchio]] = {"mujoco": ByMujoco, "pinocchio": ByPinocchio}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("case", REFERENCE["cases"], ids=lambda case: f"q4={case['q_rad'][3]}")
def test_is_dynamically_the_published_panda(engine: str, case: dict[str, Any]) -> None:
    terms = ENGINES[engine]().terms(np.array(case["q_rad"]), np.zeros(7))
    # The reference has 12 significant digits: up to 5e-12 of rounding per number near 10 to 50.
    np.testing.assert_allclose(terms["h"], case["gravity_Nm"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(terms["M"] - ARMATURE * np.eye(7), case["M_kg_m2"], rtol=0, atol=1e-11)
    np.testing.assert_allclose(terms["p"], case["tcp_position_m"], rtol=0, atol=1e-11)
    np.testing.assert_allclose(terms["R"], case["tcp_rotation"], rtol=0, atol=1e-11)


def test_mujoco_and_pinocchio_agree_on_every_term_at_random_states() -> None:
    ours, theirs = ByMujoco(), ByPinocchio()
    low, high = ours.model.jnt_range.T
    rng = np.random.default_rng(7)
    for _ in range(200):
        q, qd = rng.uniform(low, high), rng.normal(size=7)
        a, b = ours.terms(q, qd), theirs.terms(q, qd)
        # Rounding of two different recursions; the forces are of the order of 100 and add up the most.
        np.testing.assert_allclose(a["h"], b["h"], rtol=0, atol=1e-11)
        for name in ("M", "J", "p", "R"):
            np.testing.assert_allclose(a[name], b[name], rtol=0, atol=1e-13, err_msg=name)


def test_limits_are_the_published_ones_in_both_readers() -> None:
    torque = [87.0] * 4 + [12.0] * 3
    low = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
    high = [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
    ours, theirs = ByMujoco().model, ByPinocchio().model
    np.testing.assert_array_equal(ours.jnt_range, np.column_stack([low, high]))
    np.testing.assert_array_equal(ours.jnt_actfrcrange, np.column_stack([np.negative(torque), torque]))
    np.testing.assert_array_equal(ours.numeric("velocity_limit").data, [2.175] * 4 + [2.61] * 3)
    np.testing.assert_array_equal(theirs.lowerPositionLimit, low)
    np.testing.assert_array_equal(theirs.upperPositionLimit, high)


def test_the_whole_arm_weighs_what_the_published_links_weigh() -> None:
    links = [0.629769, 4.970684, 0.646926, 3.228604, 3.587895, 1.225946, 1.666555, 0.735522]
    hand = [0.73, 0.015, 0.015]
    assert ByMujoco().model.body_mass.sum() == pytest.approx(sum(links + hand), abs=1e-12)  # rounding of a sum


def test_the_description_brings_no_friction_and_no_contact_of_its_own() -> None:
    model = ByMujoco().model
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()
    assert not (model.geom_contype | model.geom_conaffinity).any()


def test_both_readers_see_one_tree_that_begins_at_link0() -> None:
    ours, theirs = ByMujoco().model, ByPinocchio().model
    assert (ours.nv, theirs.nv) == (7, 7)  # Pinocchio silently drops every top-level body but the first
    assert np.count_nonzero(ours.body_parentid[1:] == 0) == 1
    assert list(theirs.names)[1:] == [f"joint{k}" for k in range(1, 8)]


def test_digest_is_that_of_the_bytes() -> None:
    assert arm_digest("panda") == hashlib.sha256(arm_path("panda").read_bytes()).hexdigest()


@pytest.mark.parametrize("name", ["nobody", "", "../arms/panda", "panda.xml", "/etc/passwd"])
def test_an_unknown_name_is_refused_with_the_known_ones(name: str) -> None:
    assert "panda" in known_arms()
    for function in (arm_path, arm_digest):
        with pytest.raises(UnknownArm, match="panda") as caught:
            function(name)
        assert caught.value.name == name
        assert isinstance(caught.value, ValueError)
