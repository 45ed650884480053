"""Stills of a run: everything stands where the trace has it, and what cannot be rendered is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from plants import scenario
from processes import run_to_end

from sim_server.mujoco_plant import MujocoPlant
from sim_server.stills import stand
from sim_server.world import World, build_world

WOOD = np.array([0.72, 0.54, 0.36])
"""About the table's colour in the light."""


def at(world: World, shift: np.ndarray[Any, Any], rows: int) -> dict[str, np.ndarray[Any, Any]]:
    """A trace in which all that there is moves along by this much, (3,) m, in its last row."""
    data, moved = world.data, np.zeros((rows, 3))
    moved[-1] = shift
    pose = data.qpos[world.load_qpos]
    trace = {
        "load.position": pose[:3] + moved,
        "load.quat_wxyz": np.tile(pose[3:], (rows, 1)),
    }
    for name, ids in world.arms.items():
        trace[f"{name}.q"] = np.tile(data.qpos[ids.arm_qpos], (rows, 1))
        trace[f"{name}.base"] = data.qpos[ids.base_qpos] + moved
    return trace


def test_everything_stands_where_that_row_of_the_trace_has_it() -> None:
    """All of it shifted alike: the hands are still at their struts, which no mistake in an index leaves."""
    world = MujocoPlant(build_world(scenario())).world
    trace = at(world, np.array([1.5, -0.5, 0.0]), rows=3)
    about = {"facts": {"arms": list(world.arms), "struts": {name: ids.strut for name, ids in world.arms.items()}}}
    for row, shift in ((0, np.zeros(3)), (2, np.array([1.5, -0.5, 0.0]))):
        seen = stand(world.scenario, about, trace, row)
        np.testing.assert_allclose(
            seen.data.xpos[seen.load_body], world.data.xpos[world.load_body] + shift, rtol=0, atol=1e-12
        )
        for ids in seen.arms.values():
            gap = seen.data.site_xpos[ids.tcp_site] - seen.data.site_xpos[ids.grasp_site]
            np.testing.assert_allclose(gap, 0.0, atol=1e-9)


def test_a_robot_that_was_not_there_is_not_in_the_picture() -> None:
    world = build_world(scenario())
    trace = at(world, np.zeros(3), rows=1)
    trace["a3.q"] = np.full_like(trace["a3.q"], np.nan)
    about = {"facts": {"arms": list(world.arms), "struts": {name: ids.strut for name, ids in world.arms.items()}}}
    assert list(stand(world.scenario, about, trace, 0).arms) == ["a1", "a2", "a4"]


@pytest.mark.system
def test_a_run_is_rendered_from_its_trace(tmp_path: Path) -> None:
    done = run_to_end("run", "hold", "--out", "run", "--no-picture", "--set", "duration_s=0.05", cwd=tmp_path)
    assert (tmp_path / "run" / "trace.parquet").exists(), done.stderr
    assert not (tmp_path / "run" / "run.png").exists()
    rendered = run_to_end("render", "run", "--out", "still.png", cwd=tmp_path)
    if rendered.returncode == 3:
        assert "libegl1" in rendered.stderr
        assert "libosmesa6" in rendered.stderr
        assert not (tmp_path / "still.png").exists()
        pytest.skip("no library for off-screen OpenGL on this machine (EGL or OSMesa)")
    assert rendered.returncode == 0, rendered.stderr
    picture = matplotlib.image.imread(tmp_path / "still.png")[:, :, :3]
    assert picture.shape == (720, 1280, 3)
    wooden = (np.abs(picture - WOOD) < 0.12).all(axis=2)
    assert 0.005 < wooden.mean() < 0.3, "the table is in the picture, and not all of it"


def test_what_is_no_run_is_refused_in_one_sentence(tmp_path: Path) -> None:
    rendered = run_to_end("render", "nowhere", "--out", "still.png", cwd=tmp_path)
    assert rendered.returncode == 2
    assert len(rendered.stderr.splitlines()) == 1
    assert "nowhere is no run folder" in rendered.stderr
    assert not (tmp_path / "still.png").exists()
