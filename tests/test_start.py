"""Start differences: by the seed, within their bounds, and every hand on its strut; and the factor on all others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plants import plant_of, scenario

from sim_server.differences import draw_differences
from sim_server.errors import ScenarioError
from sim_server.layout import Pose
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario import SCALED, Plant
from sim_server.scenario_files import load_scenario
from sim_server.scene import rotation
from sim_server.world import World, build_world

Array = NDArray[np.float64]

OFF: dict[str, Any] = {"start_offset_m": 0.02, "start_yaw_rad": 0.05}


def gaps(world: World) -> Array:
    """How far every hand is from its strut, and turned, (N, 2) m and rad."""
    data, found = world.data, []
    for ids in world.arms.values():
        R = rotation(data, ids.grasp_site).T @ rotation(data, ids.tcp_site)
        turned = np.linalg.norm(R - np.eye(3)) / np.sqrt(2.0)
        found.append([np.linalg.norm(data.site_xpos[ids.tcp_site] - data.site_xpos[ids.grasp_site]), turned])
    return np.array(found)


def planar(place: Array) -> Pose:
    x, y, yaw = place.tolist()
    return Pose.planar(x, y, 0.0, yaw)


def places(world: World) -> dict[str, Array]:
    """x, y, yaw of the load and of all bases."""
    found = {name: world.data.qpos[ids.base_qpos].copy() for name, ids in world.arms.items()}
    return {**found, "load": np.array([*world.X_WO_start.p[:2], world.X_WO_start.yaw])}


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("fixed", [False, True])
def test_every_hand_is_on_its_strut_wherever_its_base_starts(seed: int, fixed: bool) -> None:
    world = build_world(scenario(4, seed=seed, plant=OFF, base={"fixed": fixed}, leader=None))
    assert gaps(world).max() < 1e-9  # of two rotation matrices, by rounding
    changed = [world.data.qpos[ids.arm_qpos] - world.q_home for ids in world.arms.values()]
    assert 1e-3 < np.abs(changed).max() < 0.3
    assert not world.data.qvel.any()
    plant = MujocoPlant(world)
    for _ in range(50):
        plant.step()
    assert np.linalg.norm(plant.load_pose().linear_velocity) < 0.02  # nothing snaps together


def test_bases_and_load_start_within_the_bounds_and_the_load_takes_the_team_along() -> None:
    nominal, off, within = places(build_world(scenario(4))), [], []
    for seed in range(1, 13):
        world = build_world(scenario(4, seed=seed, plant=OFF))
        load = places(world)["load"]
        off.append(load)
        X_WO = planar(load)
        for name, ids in world.arms.items():
            meant = X_WO.compose(planar(nominal[name]))
            X = meant.inverse().compose(planar(world.data.qpos[ids.base_qpos]))
            within.append([X.p[0], X.p[1], X.yaw])
    for drawn in (np.array(off), np.array(within)):
        share = np.abs(drawn) / (0.02, 0.02, 0.05)
        assert share.max() <= 1.0 + 1e-9
        assert (share.max(axis=0) > 0.7).all()  # of a dozen draws or more
        assert len(np.unique(drawn[:, 0])) == len(drawn)


def test_a_start_depends_on_the_seed_alone_and_an_arms_not_on_the_team() -> None:
    one, again, other = (places(build_world(scenario(4, seed=seed, plant=OFF))) for seed in (1, 1, 2))
    for name in one:
        np.testing.assert_array_equal(one[name], again[name])
        assert (one[name] != other[name]).any()
    three = places(build_world(scenario(3, seed=1, plant=OFF, load={"struts": 4})))
    np.testing.assert_array_equal(three["a2"], one["a2"])


def test_without_start_differences_everything_starts_where_it_is_meant_to() -> None:
    world = build_world(scenario(4, seed=5))
    for ids in world.arms.values():
        np.testing.assert_array_equal(world.data.qpos[ids.arm_qpos], world.q_home)
    np.testing.assert_array_equal(places(world)["load"], np.zeros(3))


def test_a_plant_goes_on_from_a_state_of_a_start_with_differences() -> None:
    given = scenario(2, plant=OFF)
    plant, other = plant_of(given), plant_of(given)
    for _ in range(20):
        plant.step()
    other.restore(plant.state())
    for _ in range(20):
        plant.step()
        other.step()
    np.testing.assert_array_equal(plant.world.data.qpos, other.world.data.qpos)


# One factor on all


@pytest.mark.parametrize("scale", [0.0, 1.0, 3.0])
def test_the_factor_scales_every_difference_with_the_same_draws(scale: float) -> None:
    plain, scaled = draw_differences(Plant(), 7, 2), draw_differences(Plant(difference_scale=scale), 7, 2)
    np.testing.assert_allclose(scaled.link_scale - 1.0, scale * (plain.link_scale - 1.0), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(scaled.joint_damping, scale * plain.joint_damping, rtol=1e-12)
    np.testing.assert_allclose(scaled.joint_friction, scale * plain.joint_friction, rtol=1e-12)
    no_noise = dict.fromkeys((name for name in SCALED if "noise" in name), 0.0)
    exact, noisy, noisier = (
        np.array(plant_of(scenario(1, plant=plant)).read()["a1"].q)
        for plant in (no_noise, {}, {"difference_scale": scale, "link_mass_error": 0.0})
    )
    np.testing.assert_allclose(noisier - exact, scale * (noisy - exact), rtol=0, atol=1e-14)


def test_every_difference_and_noise_of_the_plant_is_scaled() -> None:
    """A new one that is forgotten here would not be."""
    others = {"physics_step_ms", "difference_scale", "start_offset_m", "start_yaw_rad", "delay_ticks"}
    assert set(SCALED) == Plant.model_fields.keys() - others


@pytest.mark.parametrize(
    ("plant", "key", "said"),
    [
        ({"difference_scale": -1.0}, "plant.difference_scale", "greater than or equal to 0"),
        ({"difference_scale": 40.0}, "plant.difference_scale", "40 times link_mass_error = 0.03 is 1.2"),
        ({"start_offset_m": 0.5}, "plant.start_offset_m", "less than or equal to 0.05"),
        ({"start_yaw_rad": -0.1}, "plant.start_yaw_rad", "greater than or equal to 0"),
    ],
)
def test_differences_that_cannot_be_are_refused(plant: dict[str, float], key: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=said) as error:
        load_scenario("transport", {"plant": plant})
    assert error.value.key == key
