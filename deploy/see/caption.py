"""A caption below a picture, in the picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from sim_server.marks import ARROW_M_PER_N, LEADER_COLOUR, PUSH_COLOUR, eight_bit

TEXT_TO_HEIGHT = 1 / 26
"""Height of the letters against the picture's."""
INK = (40, 40, 40)


def write_caption(picture: NDArray[np.uint8], text: str, *, forces: bool) -> NDArray[np.uint8]:
    """The picture, (height, width, 3), with a line of text at its foot.

    Args:
        forces: with a second line that says what the arrows are.
    """
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image, "RGBA")
    width, height = image.size
    letter = max(9, round(height * TEXT_TO_HEIGHT))
    line, margin = round(1.45 * letter), round(0.6 * letter)
    font = ImageFont.load_default(letter)
    top = height - line * (2 if forces else 1) - margin
    draw.rectangle((0, top - margin // 2, width, height), fill=(255, 255, 255, 170))
    draw.text((margin, top), text, font=font, fill=INK)
    if forces:
        at = float(margin)
        for word, colour in (
            ("leader", LEADER_COLOUR),
            ("pushes", PUSH_COLOUR),
            (f"wrists: each arm's colour; 1 m of arrow is {1 / ARROW_M_PER_N:g} N", None),
        ):
            ink = INK if colour is None else eight_bit(colour)
            draw.text((at, top + line), word, font=font, fill=ink)
            at += draw.textlength(word + "   ", font=font)
    return np.asarray(image.convert("RGB"))
