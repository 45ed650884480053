"""A run played back: everything stands where it stood, forces balance, and blocks make the same as the whole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import QUIET, plant_of, scenario
from recorded import GRAVITY, Array, rows_of, trace_of

from sim_server.mujoco_plant import MujocoPlant
from sim_server.playback import Playback, thinned


@pytest.fixture(scope="module")
def seen() -> tuple[MujocoPlant, dict[str, Array], Array]:
    """A plant, its trace, and where its bodies were at every row, as the plant itself had them."""
    plant = plant_of(scenario(plant=QUIET))
    rows, poses = [], []
    for _ in range(20):
        rows += rows_of(plant, 1)
        poses.append(plant.world.data.xpos.copy())  # of the state that the step started from, as the row is
    return plant, trace_of(plant, rows), np.array(poses)


def playback_of(plant: MujocoPlant) -> Playback:
    return Playback(plant.world.scenario, {name: ids.strut for name, ids in plant.world.arms.items()})


def test_every_body_stands_where_the_simulation_had_it(seen: tuple[MujocoPlant, dict[str, Array], Array]) -> None:
    plant, trace, poses = seen
    playback = playback_of(plant)
    motion = playback.motion(trace, range(len(poses)))
    names = [plant.world.model.body(k).name for k in range(plant.world.model.nbody)]
    assert playback.bodies == names[1:]
    assert np.ptp(motion.p, axis=0).max() > 1e-6  # something moves at all
    np.testing.assert_allclose(motion.p, poses[:, 1:], rtol=0, atol=1e-12)


def test_wrists_bear_the_load_and_the_hands(seen: tuple[MujocoPlant, dict[str, Array], Array]) -> None:
    """At rest the upward forces at the wrists are the weight of the load and of all that hangs on the flanges."""
    plant, trace, _ = seen
    motion = playback_of(plant).motion(trace, [0])
    up = sum(float(motion.forces[f"{arm}/wrist"].force[0, 2]) for arm in plant.world.arms)
    model = plant.world.model
    hanging = sum(
        model.body_mass[k]
        for k in range(model.nbody)
        if model.body(k).name.rpartition("/")[2] in ("hand", "left_finger", "right_finger")
    )
    weight = -(plant.world.load_mass + hanging) * GRAVITY[2]
    assert up == pytest.approx(weight, rel=0.05)  # it begins to sag in the first tick: by centimetres a second squared


def test_a_robot_that_is_not_there_has_no_place_and_no_force(seen: tuple[MujocoPlant, dict[str, Array], Array]) -> None:
    plant, trace, _ = seen
    without = {name: column for name, column in trace.items() if not name.startswith("a3.")}
    playback = playback_of(plant)
    motion = playback.motion(without, [0])
    gone = np.isnan(motion.p[0, :, 0])
    assert [name for name, away in zip(playback.bodies, gone, strict=True) if away] == [
        name for name in playback.bodies if name.startswith("a3/")
    ]
    assert np.isnan(motion.forces["a3/wrist"].force).all()
    assert np.isfinite(motion.forces["a1/wrist"].force).all()
    assert playback.absent(without, 0) == ["a3"]


@given(
    cut=st.integers(0, 400),
    step_ms=st.sampled_from([1, 4, 5, 20, 40]),
    rate_hz=st.sampled_from([10.0, 30.0, 50.0]),
    first=st.integers(0, 10_000),
)
def test_a_run_that_is_cut_in_two_is_thinned_to_the_same_rows(
    cut: int, step_ms: int, rate_hz: float, first: int
) -> None:
    time_s: Array = (first + np.arange(400)) * (step_ms / 1000)
    step_s = step_ms / 1000
    whole = thinned(time_s, step_s, rate_hz)
    parts = thinned(time_s[:cut], step_s, rate_hz) + [cut + k for k in thinned(time_s[cut:], step_s, rate_hz)]
    assert parts == whole
    most = min(400.0, 400 * step_s * rate_hz)
    assert most - 2 <= len(whole) <= most + 2
