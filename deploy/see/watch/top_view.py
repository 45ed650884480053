"""The run from above: the load, its way, the goal, and every arm's base by its name. x to the right, y up."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich.text import Text

from deploy.see.watch.canvas import ACROSS, DOWN, Canvas, Glyphs
from deploy.see.watch.panels import LONGEST_NAME, STATE_STYLE, fitted, titled
from deploy.see.watch.rows import Load
from deploy.see.watch.seen import Seen

Point = tuple[float, float]

MARGIN_M, STEP_M = 0.3, 0.5
"""Room around everything, and the grid to which the window's edges snap: so that it does not move all the time."""
NOSE_M = 0.45
"""Length of the line that shows where a base looks."""
CROSS_M = 0.4
"""Half a load whose size nobody has told."""


@dataclass(frozen=True, slots=True)
class Told:
    """What only the scenario says."""

    size_m: Point | None = None
    """Of the load along its x and y."""
    goal_m: Point | None = None


NOTHING_TOLD = Told()


@dataclass(frozen=True, slots=True)
class Window:
    """The part of the floor that is shown."""

    left_m: float
    top_m: float
    dots_per_m: float

    def at(self, point: Point) -> Point:
        """Where a point of the world is on the canvas, in dots."""
        return (point[0] - self.left_m) * self.dots_per_m, (self.top_m - point[1]) * self.dots_per_m


def top_view(seen: Seen, width: int, height: int, glyphs: Glyphs, told: Told) -> list[Text]:
    """Exactly ``height`` lines, the first of which says what is seen."""
    if height < 1:
        return []
    canvas = Canvas(width, height - 1)
    if seen.load is None or height == 1:
        lines = [titled("from above", width, glyphs), *canvas.draw(glyphs)]
        return [fitted(line, width, glyphs) for line in lines]
    window = window_of(_all_points(seen, told), width, height - 1)
    for place in seen.path_m:
        canvas.dot(*window.at(place), "dim")
    for start, end in _load_lines(seen.load, told):
        canvas.line(window.at(start), window.at(end), "cyan")
    for name, arm in seen.arms.items():
        base = (arm.x_m, arm.y_m)
        if math.isfinite(sum(base) + arm.yaw_rad):
            nose = (arm.x_m + NOSE_M * math.cos(arm.yaw_rad), arm.y_m + NOSE_M * math.sin(arm.yaw_rad))
            canvas.line(window.at(base), window.at(nose), STATE_STYLE.get(seen.state_of(name), ""))
    if told.goal_m is not None:
        canvas.word(*window.at(told.goal_m), "X", "bold yellow")
    for name, arm in seen.arms.items():
        if math.isfinite(arm.x_m + arm.y_m):
            style = STATE_STYLE.get(seen.state_of(name), "")
            canvas.word(*window.at((arm.x_m, arm.y_m)), name[:LONGEST_NAME], style)
    title = f"from above, {ACROSS * width / window.dots_per_m:.1f} m wide"
    if told.goal_m is not None:
        title += ", X: goal"
    return [titled(title, width, glyphs), *canvas.draw(glyphs)]


def window_of(points: Sequence[Point], width: int, height: int) -> Window:
    """The smallest window around all points, with its middle in the middle of ``width`` by ``height`` letters."""
    edges = []
    for k in (0, 1):
        values = [point[k] for point in points if math.isfinite(point[k])] or [0.0]
        low = STEP_M * math.floor((min(values) - MARGIN_M) / STEP_M)
        high = STEP_M * math.ceil((max(values) + MARGIN_M) / STEP_M)
        edges.append((low, high))
    (left, right), (bottom, top) = edges
    scale = min(ACROSS * width / (right - left), DOWN * height / (top - bottom))
    return Window(
        left_m=(left + right) / 2 - ACROSS * width / scale / 2,
        top_m=(bottom + top) / 2 + DOWN * height / scale / 2,
        dots_per_m=scale,
    )


def _all_points(seen: Seen, told: Told) -> list[Point]:
    found = [*seen.path_m, *((arm.x_m, arm.y_m) for arm in seen.arms.values())]
    found += [point for line in _load_lines(seen.load, told) for point in line] if seen.load is not None else []
    return [*found, told.goal_m] if told.goal_m is not None else found


def _load_lines(load: Load, told: Told) -> Iterator[tuple[Point, Point]]:
    """The load's outline, and a line from its middle to its front; a cross where its size is not known."""
    x, y, _ = load.p_WO
    yaw = math.radians(load.yaw_deg)
    if not math.isfinite(x + y + yaw):
        return

    def at(forward: float, left: float) -> Point:
        return (
            x + forward * math.cos(yaw) - left * math.sin(yaw),
            y + forward * math.sin(yaw) + left * math.cos(yaw),
        )

    if told.size_m is None:
        yield at(-CROSS_M, 0.0), at(CROSS_M, 0.0)
        yield at(0.0, -CROSS_M / 2), at(0.0, CROSS_M / 2)
        return
    ahead, aside = told.size_m[0] / 2, told.size_m[1] / 2
    corners = [at(ahead, aside), at(-ahead, aside), at(-ahead, -aside), at(ahead, -aside)]
    yield from zip(corners, [*corners[1:], corners[0]], strict=True)
    yield at(0.0, 0.0), at(ahead, 0.0)
