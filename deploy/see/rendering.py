"""``palanquin render``: stills and films of a run, from its trace, with a caption."""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from deploy.exit_status import BAD_INPUT, fail
from deploy.see.caption import write_caption
from deploy.see.curves import GOAL, LOAD, TILT, Start, curves
from sim_server.errors import CannotRender
from sim_server.marks import GOAL_COLOUR, PUSH_COLOUR, eight_bit
from sim_server.robots import ACCENTS

HEADLESS = "egl"
"""What renders without a screen where nothing else is asked for."""
STILL, GIF, MP4, SEQUENCE = ".png", ".gif", ".mp4", ""
SIZES = {STILL: (1280, 720), MP4: (1280, 720), SEQUENCE: (1280, 720), GIF: (640, 360)}
"""What each kind of file has by default, pixels."""
RATES = {MP4: 30.0, SEQUENCE: 30.0, GIF: 12.5}
MOST_FRAMES = 20_000
GIF_COLOURS = 160
"""Colours of a GIF for what is most of its pictures; the marks have some more for themselves."""
SHADES = (0.45, 0.65, 0.85, 1.0, 1.15)
"""A mark's brightness in shade and light."""
GIF_UNITS_PER_S = 100
"""A GIF counts the time of a picture in hundredths."""

Picture = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to render.

    Attributes:
        at_s: moment of a still; None for a film.
        from_s, to_s: part of the run that a film shows; to its end if ``to_s`` is None.
        rate_hz: pictures a second; None for what the kind of file has by default.
        speed: simulated time over the film's.
        size: width and height, pixels, even; None for what the kind of file has by default.
        marks: with the goal and the forces.
        caption: with time, distance to the goal and tilt below.
    """

    at_s: float | None = None
    from_s: float = 0.0
    to_s: float | None = None
    rate_hz: float | None = None
    speed: float = 1.0
    size: tuple[int, int] | None = None
    marks: bool = True
    caption: bool = True


def parse_size(text: str | None) -> tuple[int, int] | None:
    """``640x360`` as width and height. Ends the verb with one sentence if it is none that can be rendered."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    width, height = map(int, found.groups()) if found else (0, 0)
    if not (64 <= width <= 1280 and 64 <= height <= 720 and width % 2 == height % 2 == 0):
        fail(f"--size {text}: expected WIDTHxHEIGHT, even, from 64x64 to 1280x720, such as 640x360", BAD_INPUT)
    return width, height


def render(folder: Path, out: Path, wanted: Wanted) -> int:
    """Write a still (.png), a film (.gif, .mp4) or a folder of numbered PNGs, whole or not at all; how many pictures.

    Before MuJoCo is loaded in this process.

    Raises:
        sim_server.run_folder.RunFolderError: it is no run folder.
        CannotRender: there is no library for off-screen OpenGL.
    """
    kind = out.suffix.lower()
    if kind not in SIZES:
        fail(
            f"--out {out}: expected a name that ends in .png, .gif or .mp4, or a folder for single pictures", BAD_INPUT
        )
    if kind == SEQUENCE and out.exists():
        fail(f"--out {out}: is there already; expected a new folder for single pictures", BAD_INPUT)
    if not out.absolute().parent.is_dir():
        fail(f"--out {out}: there is no folder {out.absolute().parent}", BAD_INPUT)
    os.environ.setdefault("MUJOCO_GL", HEADLESS)
    try:
        from sim_server.playback import read_recorded
    except (ImportError, RuntimeError, AttributeError, OSError) as error:  # MuJoCo loads what draws with itself
        if isinstance(error, ModuleNotFoundError):
            raise
        raise CannotRender(error) from None

    run = read_recorded(folder)
    first, last = (float(run.trace["time_s"][k]) for k in (0, -1))
    rate_hz = _rate(kind, wanted.rate_hz)
    if kind == STILL:
        times = [wanted.at_s or 0.0]
    else:
        times = _times(
            max(first, wanted.from_s), last if wanted.to_s is None else min(last, wanted.to_s), wanted, rate_hz
        )
    size = wanted.size or SIZES[kind]

    def pictures() -> Iterator[Picture]:
        from sim_server.film import shoot
        from sim_server.metrics import trace_facts

        lines = curves(run.trace, trace_facts(run.facts), Start.of(run.trace))
        for row, picture in shoot(run, times, size, marks=wanted.marks):
            text = f"{run.about['scenario_name']}   {run.trace['time_s'][row]:5.2f} s"
            if GOAL in lines:
                text += f"   {lines[GOAL][LOAD][row]:.2f} m to the goal"
            text += f"   tilt {lines[TILT][LOAD][row]:.2f} deg"
            yield write_caption(picture, text, forces=wanted.marks) if wanted.caption else picture

    _write(kind, out, pictures(), rate_hz)
    return len(times)


def _rate(kind: str, wanted: float | None) -> float:
    rate_hz = wanted or RATES.get(kind, 1.0)
    return GIF_UNITS_PER_S / max(2, round(GIF_UNITS_PER_S / rate_hz)) if kind == GIF else rate_hz


def _times(from_s: float, to_s: float, wanted: Wanted, rate_hz: float) -> list[float]:
    if to_s < from_s:
        fail(f"--from-s {from_s:g} is after {to_s:g} s, where the film ends", BAD_INPUT)
    step_s = wanted.speed / rate_hz
    count = math.floor((to_s - from_s) / step_s + 1e-9) + 1
    if count > MOST_FRAMES:
        fail(
            f"{count} pictures: expected at most {MOST_FRAMES}; a shorter part, a lower --fps or a higher --speed",
            BAD_INPUT,
        )
    return [from_s + step_s * k for k in range(count)]


def _write(kind: str, out: Path, pictures: Iterator[Picture], rate_hz: float) -> None:
    part = out.with_name(f"{out.name}.part")
    try:
        if kind == SEQUENCE:
            part.mkdir()
            for number, picture in enumerate(pictures):
                Image.fromarray(picture).save(part / f"{number:05}.png")
        elif kind == STILL:
            Image.fromarray(next(pictures)).save(part, format="PNG")
        elif kind == GIF:
            _write_gif(part, pictures, rate_hz)
        else:
            _write_mp4(part, pictures, rate_hz)
        os.replace(part, out)
    finally:
        if part.is_dir():
            shutil.rmtree(part)
        part.unlink(missing_ok=True)


def _write_gif(file: Path, pictures: Iterator[Picture], rate_hz: float) -> None:
    """One palette for all pictures and no dithering, so that what stands still costs nothing."""
    images = [Image.fromarray(picture) for picture in pictures]
    sample = np.hstack([np.asarray(images[k]) for k in {0, len(images) // 2, len(images) - 1}])
    most = Image.fromarray(sample).quantize(GIF_COLOURS, dither=Image.Dither.NONE).getpalette() or []
    marks = [
        min(255, round(shade * part))
        for colour in (*ACCENTS, GOAL_COLOUR, PUSH_COLOUR)
        for shade in SHADES
        for part in eight_bit(colour)
    ]
    palette = Image.new("P", (1, 1))
    palette.putpalette(most[: 3 * GIF_COLOURS] + marks)
    reduced = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    reduced[0].save(
        file,
        format="GIF",
        save_all=True,
        append_images=reduced[1:],
        duration=round(1000 / rate_hz),
        loop=0,
        optimize=False,
    )


def _write_mp4(file: Path, pictures: Iterator[Picture], rate_hz: float) -> None:
    import av

    with av.open(str(file), "w", format="mp4", options={"movflags": "faststart"}) as film:
        stream = film.add_stream("libx264", rate=round(rate_hz), options={"crf": "20", "preset": "medium"})
        stream.pix_fmt = "yuv420p"
        for number, picture in enumerate(pictures):
            if number == 0:
                stream.height, stream.width = picture.shape[:2]
            film.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        film.mux(stream.encode(None))
