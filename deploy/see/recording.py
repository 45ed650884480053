"""The one door to Rerun: what a viewer shows of a run, written in columns, and how it is laid out at first.

    scene/<body>          a body's pose; below it, once, its shapes
    scene/goal, floor
    forces/<force>        an arrow
    paths/<arm | load>    where the hand, or the load, has been
    plots/<question>/...  a line each
    events/<kind>         a sentence at a time; a row of markers on the timeline
    agents/<name>         in, lost, leaving, left

The timeline is ``sim_time``, simulated time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deploy.see.curves import QUESTIONS, TICK, Array, Question
from deploy.see.happenings import Happening
from sim_server.looks import Shape
from sim_server.marks import (
    ARROW_M_PER_N,
    GOAL_COLOUR,
    GOAL_RADIUS_M,
    SHORTEST_ARROW_N,
    arm_colour,
    eight_bit,
    force_colour,
)
from sim_server.parts import Colour
from sim_server.playback import Motion

TIMELINE = "sim_time"
FLOOR_M = 8.0
FLOOR_COLOUR: Colour = (0.78, 0.79, 0.80)
SKY: Colour = (0.90, 0.93, 0.96)
GREY = (140, 140, 140)
"""Lines of the load and the leader: seen on a dark and on a light ground."""
PATH_RADIUS_M, ARROW_RADIUS_M = 0.006, 0.012
AWAY_M = (0.0, 0.0, -100.0)
"""Where a robot is drawn that is not there: nowhere."""
STATES = {"in": (0, 158, 115), "leaving": (86, 180, 233), "left": (110, 110, 110), "lost": (213, 94, 0)}
FAREWELL_S = 5.0
"""Wall time that a viewer gets to take what is left."""
MOST_PATHS = 32
"""Arms whose paths are drawn: those that come while a run goes on are not known when it begins."""
FIRST_SHOWN = ("goal", "tilt", "sag", "share", "stiffness", "torque")
"""The questions whose plots are open at first; the others are one click away."""


class Recording:
    """A recording that is being written, to a file, to a viewer, or both.

    Args:
        name: of the run.
        file: an ``.rrd``; overwritten.
        viewer: address of a viewer that is there, such as ``rerun+http://127.0.0.1:9876/proxy``.
    """

    def __init__(self, name: str, *, file: Path | None = None, viewer: str | None = None) -> None:
        self._stream = rr.RecordingStream("palanquin")
        self._last: dict[str, Array] = {}
        self._styled: set[str] = set()
        self._has_viewer = viewer is not None
        sinks: list[Any] = []
        if file is not None:
            sinks.append(rr.FileSink(str(file)))
        if viewer is not None:
            sinks.append(rr.GrpcSink(viewer))
        self._stream.set_sinks(*sinks)
        self._stream.send_recording_name(name)

    def scene(
        self,
        shapes: Iterable[Shape],
        arms: Sequence[str],
        goal_m: Sequence[float] | None,
        size_m: Sequence[float],
        *,
        live: bool = False,
        layout: bool = True,
    ) -> None:
        """What does not change: the shapes of all bodies, the floor, the goal, colours, and how it is laid out.

        Args:
            shapes: of all bodies.
            arms: names of all arms.
            goal_m: (2,) m.
            size_m: of the load, (3,) m.
            live: with what only a run that goes on can tell.
            layout: lay it out: not when robots have come to a viewer that somebody has arranged meanwhile.
        """
        questions = (*QUESTIONS, TICK) if live else QUESTIONS
        by_place = sorted(shapes, key=lambda shape: (shape.body, shape.kind))
        for (body, kind), group in groupby(by_place, key=lambda shape: (shape.body, shape.kind)):
            self._static(f"scene/{body}/{kind}", _solids(kind, list(group)))
        self._static("scene/floor", _box((FLOOR_M, FLOOR_M, 0.01), (0.0, 0.0, -0.01), FLOOR_COLOUR))
        if goal_m is not None:
            disc = rr.Cylinders3D(
                radii=[GOAL_RADIUS_M],
                lengths=[0.01],
                centers=[[*goal_m, 0.005]],
                colors=[eight_bit(GOAL_COLOUR)],
                fill_mode="solid",
            )
            self._static("scene/goal", disc)
        for question in questions:
            for arm in arms:
                self._static(f"plots/{question.key}/{arm}", _line(arm, eight_bit(arm_colour(arm))))
            for line in ("load", "leader"):
                self._static(f"plots/{question.key}/{line}", _line(line, GREY))
        for agent in ("leader", *arms):
            self._static(f"agents/{agent}", rr.StateConfiguration(values=list(STATES), colors=list(STATES.values())))
        if layout:
            self._stream.send_blueprint(_layout(goal_m or (0.0, 0.0), max(size_m), questions))

    def motion(self, bodies: Sequence[str], motion: Motion) -> None:
        """Where everything was, and the forces."""
        if not motion.time_s.size:
            return
        for k, body in enumerate(bodies):
            absent = np.isnan(motion.p[:, k, 0])
            p = np.where(absent[:, None], AWAY_M, motion.p[:, k])
            w, x, y, z = np.where(absent, np.array([[1.0], [0.0], [0.0], [0.0]]), motion.quat_wxyz[:, k].T)
            self._columns(
                f"scene/{body}",
                motion.time_s,
                rr.Transform3D.columns(translation=p, quaternion=np.stack([x, y, z, w], axis=1)),
            )
        for name, each in motion.forces.items():
            shown = np.linalg.norm(each.force, axis=1) > SHORTEST_ARROW_N
            vectors = np.where(shown[:, None], ARROW_M_PER_N * each.force, 0.0)
            at = np.where(shown[:, None], each.at, AWAY_M)
            self._columns(f"forces/{name}", motion.time_s, rr.Arrows3D.columns(origins=at, vectors=vectors))
            style = rr.Arrows3D.from_fields(colors=[eight_bit(force_colour(name))], radii=[ARROW_RADIUS_M])
            self._once(f"forces/{name}", style)
        load = list(bodies).index("load")
        for name, p in {**motion.hands, "load": motion.p[:, load]}.items():
            self._path(name, motion.time_s, p)

    def _path(self, name: str, time_s: Array, p: Array) -> None:
        """One piece of a path for each row, from where the last ended; the layout shows all up to the present."""
        last = self._last.get(name, p[0])
        starts = np.vstack([last[None], p[:-1]])
        known = ~np.isnan(starts[:, 0]) & ~np.isnan(p[:, 0])
        self._last[name] = p[-1]
        if not known.any():
            return
        pieces = np.stack([starts[known], p[known]], axis=1)
        colour = GREY if name == "load" else eight_bit(arm_colour(name))
        self._once(f"paths/{name}", rr.LineStrips3D.from_fields(colors=[colour], radii=[PATH_RADIUS_M]))
        self._columns(f"paths/{name}", time_s[known], rr.LineStrips3D.columns(strips=pieces))

    def curves(self, time_s: Array, lines: Mapping[Question, Mapping[str, Array]]) -> None:
        """Lines of the plots, (rows,) each."""
        for question, named in lines.items():
            for name, values in named.items():
                known = np.isfinite(values)
                if known.any():
                    columns = rr.Scalars.columns(scalars=values[known])
                    self._columns(f"plots/{question.key}/{name}", time_s[known], columns)

    def happened(self, happening: Happening) -> None:
        """One event."""
        self._stream.set_time(TIMELINE, duration=happening.time_s)
        level = rr.TextLogLevel.WARN if happening.is_trouble else rr.TextLogLevel.INFO
        self._stream.log(f"events/{happening.kind}", rr.TextLog(happening.text, level=level))
        if happening.agent and happening.state:
            self._stream.log(f"agents/{happening.agent}", rr.StateChange(state=happening.state))
        self._stream.reset_time()

    def close(self) -> bool:
        """Write what is left; whether all of it was taken. A viewer that takes nothing more is not waited for longer
        than a moment: then leave the process without ceremony, for Rerun's own farewell would wait for ever.

        Raises:
            RuntimeError: a file could not be written.
        """
        if not self._has_viewer:
            self._stream.flush()
        else:
            try:
                self._stream.flush(timeout_sec=FAREWELL_S)
            except RuntimeError:
                return False
        self._stream.disconnect()
        return True

    def _once(self, path: str, what: Any) -> None:
        if path not in self._styled:
            self._styled.add(path)
            self._static(path, what)

    def _static(self, path: str, what: Any) -> None:
        self._stream.log(path, what, static=True)

    def _columns(self, path: str, time_s: Array, columns: Any) -> None:
        self._stream.send_columns(path, indexes=[rr.TimeColumn(TIMELINE, duration=time_s)], columns=columns)


def _solids(kind: str, shapes: Sequence[Shape]) -> Any:
    size = np.array([shape.size for shape in shapes])
    p = np.array([shape.p for shape in shapes])
    quat_xyzw = np.array([[*shape.quat_wxyz[1:], shape.quat_wxyz[0]] for shape in shapes])
    colours = [eight_bit(shape.colour) for shape in shapes]
    if kind == "box":
        return rr.Boxes3D(half_sizes=size, centers=p, quaternions=quat_xyzw, colors=colours, fill_mode="solid")
    if kind == "cylinder":
        return rr.Cylinders3D(
            radii=size[:, 0],
            lengths=2 * size[:, 1],
            centers=p,
            quaternions=quat_xyzw,
            colors=colours,
            fill_mode="solid",
        )
    if kind == "sphere":
        return rr.Ellipsoids3D(radii=size[:, 0], centers=p, colors=colours, fill_mode="solid")
    # A capsule of Rerun's begins at its origin; one of MuJoCo's has it in its middle.
    x, y, z, w = quat_xyzw.T
    axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
    return rr.Capsules3D(
        radii=size[:, 0],
        lengths=2 * size[:, 1],
        translations=p - size[:, 1:2] * axis,
        quaternions=quat_xyzw,
        colors=colours,
        fill_mode="solid",
    )


def _line(name: str, colour: tuple[int, int, int]) -> Any:
    return rr.SeriesLines(colors=[colour], names=[name], widths=[1.5])


def _box(half: Sequence[float], centre: Sequence[float], colour: Colour) -> Any:
    return rr.Boxes3D(half_sizes=[half], centers=[centre], colors=[eight_bit(colour)], fill_mode="solid")


def _layout(goal_m: Sequence[float], size_m: float, questions: Sequence[Question]) -> Any:
    """The scene beside the plots, the events below."""
    middle = np.array([goal_m[0] / 2, goal_m[1] / 2, 0.4])
    away = 2.0 + 0.65 * float(np.hypot(goal_m[0], goal_m[1])) + 0.6 * size_m
    so_far = rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    paths = ("load", *(f"a{k + 1}" for k in range(MOST_PATHS)))
    scene = rrb.Spatial3DView(
        origin="/",
        contents=["+ /scene/**", "+ /forces/**", "+ /paths/**"],
        name=f"Scene (arrows: 1 m is {1 / ARROW_M_PER_N:g} N)",
        background=eight_bit(SKY),
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, stroke_width=1.0, color=(150, 155, 160)),
        eye_controls=rrb.EyeControls3D(
            position=middle + away * np.array([0.55, -0.75, 0.5]), look_target=middle, eye_up=(0, 0, 1)
        ),
        overrides={f"/paths/{name}": so_far for name in paths},
    )
    plots = {
        question.key: rrb.TimeSeriesView(
            origin=f"/plots/{question.key}",
            name=f"{question.quantity[0].upper()}{question.quantity[1:]} [{question.unit}]",
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
        )
        for question in questions
    }
    first = rrb.Grid(*(plots[key] for key in FIRST_SHOWN), grid_columns=2, name="First")
    more = rrb.Grid(*(plot for key, plot in plots.items() if key not in FIRST_SHOWN), grid_columns=2, name="More")
    below = rrb.Horizontal(
        rrb.TextLogView(origin="/events", name="Events"),
        rrb.StateTimelineView(origin="/agents", name="Agents"),
        column_shares=[3, 2],
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, below, row_shares=[3, 1]), rrb.Tabs(first, more, active_tab=0), column_shares=[3, 2]
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, playback_speed=1.0),
        auto_views=False,
    )
