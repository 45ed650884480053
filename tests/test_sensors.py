"""The MuJoCo plant's sensors against the truth and their stated sigma."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from plants import NO_STIFFNESS, QUIET, plant_of, scenario

from sim_server.mujoco_plant import MujocoPlant
from sim_server.sensor_noise import SensorNoise
from sim_server.world import ArmIds

Array = NDArray[np.float64]


# Sensors


def exact_and_sensed(plant: MujocoPlant, reads: int) -> tuple[Array, Array]:
    """The truth, (arms, 27), and ``reads`` readings of it, (reads, arms, 27): q, qd, tau, wrench."""
    data, arms = plant.world.data, plant.world.arms.values()

    def truth(ids: ArmIds) -> Array:
        sensor = data.sensordata
        motors = data.qfrc_applied[ids.arm_dof]
        parts = (data.qpos[ids.arm_qpos], data.qvel[ids.arm_dof], motors)
        return np.concatenate([*parts, sensor[ids.force_sensor], sensor[ids.torque_sensor]])

    sensed = [
        [np.concatenate([each.q, each.qd, each.tau, each.wrench]) for each in plant.read().values()]
        for _ in range(reads)
    ]
    return np.array([truth(ids) for ids in arms]), np.array(sensed)


def test_sensor_noise_has_the_stated_sigma_no_bias_and_no_echo() -> None:
    stated = {
        "position_noise_rad": 2e-3,
        "velocity_noise_rad_s": 0.03,
        "torque_noise_Nm": 0.4,
        "wrench_noise_N": 1.5,
        "wrench_noise_Nm": 0.06,
    }
    plant = plant_of(scenario(plant=stated))
    for _ in range(3):
        plant.step()
    reads = 2000
    exact, sensed = exact_and_sensed(plant, reads)
    sigma = np.repeat(list(stated.values()), [7, 7, 7, 3, 3])
    z = (sensed - exact) / sigma
    kinds = np.split(z, [7, 14, 21, 24], axis=2)
    for kind in kinds:
        n = kind.size
        # Five standard errors of a normal sample's deviation and mean: a false alarm in two million.
        assert np.std(kind) == pytest.approx(1.0, abs=5 / np.sqrt(2 * n))
        assert abs(np.mean(kind)) < 5 / np.sqrt(n)
    channels = z.reshape(reads, -1)
    echo = np.corrcoef(channels.T) - np.eye(channels.shape[1])
    # 108 channels, 5778 pairs: the largest of so many is near 4 standard errors; 6 is a false alarm in 1e5.
    assert np.abs(echo).max() < 6 / np.sqrt(reads)
    assert abs(np.mean(channels[1:] * channels[:-1])) < 5 / np.sqrt(channels.size)


def test_without_noise_sensors_tell_the_truth() -> None:
    plant = plant_of(scenario(plant=QUIET))
    plant.step()
    exact, sensed = exact_and_sensed(plant, 1)
    np.testing.assert_array_equal(sensed[0], exact)


def test_noise_is_repeatable_per_seed_and_another_seed_is_another_noise() -> None:
    first, again, other = (exact_and_sensed(plant_of(scenario(seed=seed)), 3)[1] for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert not np.isin(first, other).any()


def test_the_torque_sensor_lags_no_more_than_the_driver() -> None:
    """What is measured is what the driver applies, which moves towards a command by 1 N m in each millisecond."""
    plant = plant_of(scenario(plant=QUIET))
    start = np.array(plant.read()["a1"].tau)
    measured = []
    for _ in range(4):
        plant.command("a1", start + 2.5, np.zeros(3), NO_STIFFNESS)
        plant.step()
        measured.append(plant.read()["a1"].tau - start)
    # Rounding of torques below 100 N m.
    np.testing.assert_allclose(measured, np.outer([1.0, 2.0, 2.5, 2.5], np.ones(7)), rtol=0, atol=1e-13)


def test_an_arms_noise_tells_nothing_of_the_others_not_even_how_many_there_are() -> None:
    """Whoever knows the seed could otherwise read the size of the team from it."""
    alone, team = (SensorNoise(np.ones(27), seed=4, arms=arms) for arms in (1, 5))
    for _ in range(600):  # past two blocks of numbers drawn ahead
        np.testing.assert_array_equal(alone.draw()[0], team.draw()[0])
    of_five = team.draw()
    assert len(np.unique(of_five)) == of_five.size
