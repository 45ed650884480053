"""What a model looks like: its shapes, for viewers that draw by themselves, and pictures of it by MuJoCo's renderer."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim_server.layout import Array
from sim_server.marks import GOAL_COLOUR, GOAL_RADIUS_M
from sim_server.parts import Colour

Kind = Literal["box", "cylinder", "capsule", "sphere"]

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
}
TOUCHED_ONLY = 3
"""Geom group of the collision boxes: they are not to be looked at."""
SHADOW_TO_WIDTH = 4
"""Texels of the shadow map for a pixel of the picture's width."""
ARROW_WIDTH_M = 0.018


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of a body that is seen.

    Attributes:
        body: name of the body, such as ``load`` or ``a1/link3``.
        size: box: half lengths; cylinder and capsule: radius, half length, 0; sphere: radius, 0, 0, (3,) m.
        p, quat_wxyz: pose in the body's frame, (3,) m and (4,); cylinders and capsules lie along its z.
        colour: red, green, blue, 0 to 1.
    """

    body: str
    kind: Kind
    size: Array
    p: Array
    quat_wxyz: Array
    colour: Colour


@dataclass(frozen=True, eq=False)
class Arrow:
    """An arrow to be drawn: from a point along a vector, (3,) m each, world."""

    start: Array
    vector: Array
    colour: Colour


def shapes(model: Any) -> list[Shape]:
    """All shapes that are seen, but for the floor. Of a model that was compiled to be looked at."""
    found = []
    for geom in range(model.ngeom):
        kind = _KINDS.get(int(model.geom_type[geom]))
        if kind is None or model.geom_group[geom] == TOUCHED_ONLY:
            continue
        red, green, blue, _ = model.geom_rgba[geom].tolist()
        found.append(
            Shape(
                body=model.body(int(model.geom_bodyid[geom])).name,
                kind=kind,
                size=model.geom_size[geom].copy(),
                p=model.geom_pos[geom].copy(),
                quat_wxyz=model.geom_quat[geom].copy(),
                colour=(red, green, blue),
            )
        )
    return found


class Camera:
    """Takes pictures of a world from the front left and above. Needs a library for off-screen OpenGL.

    Args:
        model: compiled to be looked at.
        lookat: the point in the pictures' middle, (3,) m.
        distance_m: of the camera from it.
        size: width and height, pixels; at most what the model's off-screen buffer has.

    Raises:
        RuntimeError, and what else MuJoCo raises: there is nothing to draw with.
    """

    def __init__(self, model: Any, lookat: Array, distance_m: float, size: tuple[int, int]) -> None:
        self._model, self._alpha = model, model.geom_rgba[:, 3].copy()
        # The world's is for the largest pictures; drawing it is most of the work without a graphics card.
        model.vis.quality.shadowsize = min(int(model.vis.quality.shadowsize), SHADOW_TO_WIDTH * size[0])
        try:
            self._renderer = mujoco.Renderer(model, size[1], size[0])
        except mujoco.FatalError as error:  # a window library without a screen to open a window on
            raise RuntimeError(str(error)) from None
        self._eye = mujoco.MjvCamera()
        self._eye.lookat[:], self._eye.distance = lookat, distance_m
        self._eye.azimuth, self._eye.elevation = 125.0, -22.0

    def shoot(
        self,
        data: Any,
        *,
        arrows: Sequence[Arrow] = (),
        goal: Array | None = None,
        without: Collection[int] = (),
    ) -> NDArray[np.uint8]:
        """A picture, (height, width, 3).

        Args:
            arrows: drawn into it.
            goal: a disc on the floor there, (2,) m.
            without: numbers of bodies that are left out.
        """
        self._model.geom_rgba[:, 3] = np.where(np.isin(self._model.geom_bodyid, list(without)), 0.0, self._alpha)
        self._renderer.update_scene(data, self._eye)
        for arrow in arrows:
            self._draw_arrow(arrow)
        if goal is not None:
            self._draw_goal(goal)
        picture: NDArray[np.uint8] = self._renderer.render().copy()
        return picture

    def _draw_arrow(self, arrow: Arrow) -> None:
        geom = self._next_geom(mujoco.mjtGeom.mjGEOM_ARROW, arrow.colour)
        if geom is not None:
            end = arrow.start + 2 * arrow.vector  # MuJoCo draws an arrow half as long as it is told
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, ARROW_WIDTH_M, arrow.start, end)

    def _draw_goal(self, goal: Array) -> None:
        geom = self._next_geom(mujoco.mjtGeom.mjGEOM_CYLINDER, GOAL_COLOUR)
        if geom is not None:
            geom.size[:] = GOAL_RADIUS_M, GOAL_RADIUS_M, 0.004
            geom.pos[:] = *goal, 0.004

    def _next_geom(self, kind: Any, colour: Colour) -> Any:
        """Another geom of the picture, that the world does not have; None if the picture is full."""
        scene = self._renderer.scene
        if scene.ngeom >= scene.maxgeom:
            return None
        geom = scene.geoms[scene.ngeom]
        scene.ngeom += 1
        rgba = np.array([*colour, 1.0], np.float32)
        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
        return geom

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._model.geom_rgba[:, 3] = self._alpha
        self._renderer.close()
