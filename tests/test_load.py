"""The load: its mass and inertia against sums done by hand and MuJoCo's own, its points, and what it touches."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from worlds import EXACT, hold, scenario

from sim_server.grips import grip_wrenches
from sim_server.loads import load_body
from sim_server.parts import MEETS, Touch
from sim_server.scenario import Load
from sim_server.world import World, build_world

# The load


def test_crate_with_its_handle_has_the_inertia_done_by_hand() -> None:
    body = load_body(Load(shape="crate", size_m=(0.4, 0.4, 0.3), mass_kg=2.5, struts=1)).inertia
    # Box, bar 180 x 30 x 30 mm at 0.36 m, two posts 30 x 30 x 45 mm at x = -+75 mm and 0.3225 m: volumes in litres.
    box, bar, post = 48.0, 0.162, 0.0405
    per_litre = 2.5 / (box + bar + 2 * post)
    z = (box * 0.15 + bar * 0.36 + 2 * post * 0.3225) / (box + bar + 2 * post)
    izz = per_litre * (
        box * (0.4**2 + 0.4**2) / 12 + bar * (0.18**2 + 0.03**2) / 12 + 2 * post * (2 * 0.03**2 / 12 + 0.075**2)
    )
    ixx = per_litre * (
        box * ((0.4**2 + 0.3**2) / 12 + (z - 0.15) ** 2)
        + bar * (2 * 0.03**2 / 12 + (z - 0.36) ** 2)
        + 2 * post * ((0.03**2 + 0.045**2) / 12 + (z - 0.3225) ** 2)
    )
    np.testing.assert_allclose(body.com, [0, 0, z], rtol=0, atol=1e-15)
    assert body.I[2, 2] == pytest.approx(izz, rel=1e-12)  # rounding
    assert body.I[0, 0] == pytest.approx(ixx, rel=1e-12)
    np.testing.assert_allclose(body.I - np.diag(np.diag(body.I)), 0, atol=1e-15)


def rotation(quat_wxyz: Any) -> Any:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quat_wxyz)
    return R.reshape(3, 3)


def mujocos_inertia(world: World) -> tuple[Any, Any]:
    """Centre of mass and inertia in O's axes of the load's shapes at one density, as MuJoCo makes them from geoms."""
    spec, model = mujoco.MjSpec(), world.model
    body = spec.worldbody.add_body()
    geoms = np.flatnonzero(model.geom_bodyid == world.load_body)
    volume = np.prod(2 * model.geom_size[geoms], axis=1).sum()
    for g in geoms:
        body.add_geom(
            type=model.geom_type[g],
            size=model.geom_size[g],
            pos=model.geom_pos[g],
            quat=model.geom_quat[g],
            density=world.load_mass / volume,
        )
    alone = spec.compile()
    R = rotation(alone.body_iquat[1])
    return alone.body_ipos[1], R @ np.diag(alone.body_inertia[1]) @ R.T


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.05)])
@pytest.mark.parametrize(("shape", "struts"), [("table", 5), ("crate", 3), ("table", 4)])
def test_a_load_has_exactly_its_mass_and_the_inertia_of_its_parts_and_the_offset(
    shape: str, struts: int, offset: tuple[float, float, float]
) -> None:
    world = build_world(scenario(2, shape=shape, struts=struts, mass_kg=23.0, centre_of_mass_offset_m=offset))
    model, body = world.model, world.load_body
    com, inertia = mujocos_inertia(world)
    R = rotation(model.body_iquat[body])
    assert model.body_mass[body] == 23.0
    assert model.body_subtreemass[body] == 23.0
    # MuJoCo adds up quaternion-rotated parts and diagonalises: rounding of kg m^2 of order 10.
    np.testing.assert_allclose(model.body_ipos[body], com + offset, rtol=0, atol=1e-12)
    np.testing.assert_allclose(world.load_com, com + offset, rtol=0, atol=1e-12)
    np.testing.assert_allclose(R @ np.diag(model.body_inertia[body]) @ R.T, inertia, rtol=0, atol=1e-11)


def test_named_points_lie_on_the_rim_at_the_struts_level() -> None:
    world = build_world(scenario(4))
    z = 0.75 - 0.03 - 0.015
    expected = {"centre": (0, 0), "front": (0.8, 0), "back": (-0.8, 0), "left": (0, 0.45), "right": (0, -0.45)}
    assert world.load_points.keys() == expected.keys()
    for name, point in world.load_points.items():
        np.testing.assert_allclose(point, [*expected[name], z], atol=1e-15)


def test_a_load_that_all_let_go_of_stands_on_its_legs() -> None:
    world = build_world(scenario(4, plant=EXACT))
    world.data.eq_active[:] = 0
    hold(world, 1.0)
    assert abs(world.data.qpos[world.load_qpos][2]) < 2e-3  # MuJoCo's contacts give by about a millimetre
    assert abs(world.data.qvel[world.load_dof]).max() < 1e-2
    assert not grip_wrenches(world).any()


def test_contact_classes_meet_each_other_or_not_at_all() -> None:
    for a in Touch:
        for b in Touch:
            assert bool(MEETS[a] & b) == bool(MEETS[b] & a)


def test_a_base_does_not_drive_through_a_leg() -> None:
    world = build_world(scenario(4, plant=EXACT))
    data, base, load = world.data, world.arms["a1"].base_body, world.load_body
    data.qpos[world.arms["a1"].base_qpos] = 0.8 - 0.08, 0.45 - 0.08 + 0.28, -np.pi / 2  # its front 2 cm into a leg
    mujoco.mj_forward(world.model, data)
    pairs = {frozenset(world.model.geom_bodyid[contact.geom]) for contact in data.contact}
    assert frozenset({base, load}) in pairs
