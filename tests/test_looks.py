"""What a model looks like: shapes stand where MuJoCo has them, and what is drawn into a picture is where it is told."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plants import scenario

from sim_server.looks import shapes
from sim_server.metrics import rotation_matrices
from sim_server.world import World, build_world

Picture = NDArray[Any]


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(scenario(count=2), to_look_at=True)


def test_every_shape_that_is_seen_stands_where_mujoco_has_it(world: World) -> None:
    """A body's pose and the shape's in it give MuJoCo's own pose of the geom; none is left out but floor and touch."""
    model, data = world.model, world.data
    seen = [k for k in range(model.ngeom) if model.geom_group[k] != 3 and model.geom(k).name != "floor"]
    found = shapes(model)
    assert len(found) == len(seen) > 50
    for geom, shape in zip(seen, found, strict=True):
        body = data.body(shape.body)
        R = body.xmat.reshape(3, 3)
        np.testing.assert_allclose(body.xpos + R @ shape.p, data.geom_xpos[geom], rtol=0, atol=1e-9)
        R_shape = R @ rotation_matrices(shape.quat_wxyz[None])[0]
        np.testing.assert_allclose(R_shape, data.geom_xmat[geom].reshape(3, 3), rtol=0, atol=1e-9)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Picture]:
    """The pictures of tests/drawn.py."""
    file = tmp_path_factory.mktemp("drawn") / "pictures.npz"
    script = Path(__file__).with_name("drawn.py")
    environment = {**os.environ, "MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")}
    done = subprocess.run(
        [sys.executable, script, file], env=environment, capture_output=True, text=True, timeout=100, check=False
    )
    if done.returncode and re.search("EGL|OSMesa|OpenGL|osmesa|egl", done.stderr):
        pytest.skip(f"no library for off-screen OpenGL on this machine: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    with np.load(file) as pictures:
        return {name: pictures[name].astype(int) for name in pictures}


def test_an_arrow_ends_where_its_force_says_and_no_sooner(drawn: Mapping[str, Picture]) -> None:
    """From a metre above the goal's disc down to it: it covers the middle of the disc. Half as long, it does not."""
    disc = drawn["goal"]
    red = (disc[:, :, 0] > disc[:, :, 1] + 60) & (disc[:, :, 0] > disc[:, :, 2] + 60)
    assert red.sum() > 30
    covered = {
        name: int(((np.abs(drawn[name] - disc).max(axis=2) > 30) & red).sum()) for name in ("whole_arrow", "half_arrow")
    }
    assert covered["whole_arrow"] > 0
    assert covered["half_arrow"] == 0


def test_bodies_that_are_left_out_are_not_in_the_picture_and_come_back(drawn: Mapping[str, Picture]) -> None:
    np.testing.assert_array_equal(drawn["world"], drawn["again"])
    assert (drawn["world"] != drawn["without"]).any(axis=2).mean() > 0.01
