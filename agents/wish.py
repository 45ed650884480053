"""What a person wants of the leader, and the line of text that carries it from the device to the leader's process.

The process that reads a keyboard or a gamepad is not the one that leads: that one is shut in and has no device. A line
is all that passes between them: ``pull X Y``, ``brake`` or ``leave``. Only the newest counts.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

MAX_LINE = 100
"""Bytes of a line; a longer one is none of ours."""
ARROWS = "↑↖←↙↓↘→↗"
"""Directions in the world's plane, by eighths of a turn from +x: ahead is +x, left is +y."""


class NoWish(ValueError):
    """A line that is none, or a pull that is no part of the largest one."""


@dataclass(frozen=True, slots=True)
class Wish:
    """One wish; without anything it is to let go."""

    share: tuple[float, float] = (0.0, 0.0)
    """The pull as a part of the largest one, (2,), world, each within -1 and 1; the leader shortens it to 1."""
    brake: bool = False
    """Pull against the load's motion."""
    leave: bool = False
    """Say goodbye: nobody leads any more."""

    def __post_init__(self) -> None:
        if not all(abs(part) <= 1.0 for part in self.share):
            raise NoWish(f"wish: got a pull of {self.share} parts of the largest one, expected -1 to 1")

    def line(self) -> bytes:
        """As :meth:`read` takes it, with its end of line."""
        if self.leave:
            return b"leave\n"
        return b"brake\n" if self.brake else "pull {!r} {!r}\n".format(*self.share).encode()

    @classmethod
    def read(cls, line: bytes) -> Wish:
        """From a line. Raises :class:`NoWish`."""
        match line.split():
            case [b"leave"]:
                return cls(leave=True)
            case [b"brake"]:
                return cls(brake=True)
            case [b"pull", x, y]:
                with suppress(ValueError):
                    return cls((float(x), float(y)))
        raise NoWish(f"wish {line[:MAX_LINE]!r}: expected pull X Y (parts of the largest, -1 to 1), brake, or leave")

    def says(self, force_max_N: float) -> str:
        """For people: what it asks for, where the pull may be ``force_max_N`` at most."""
        if self.leave:
            return "leaving"
        if self.brake:
            return "braking"
        size = min(1.0, math.hypot(*self.share))
        if not size:
            return "let go"
        eighth = round(math.atan2(self.share[1], self.share[0]) / (math.pi / 4)) % 8
        return f"pull {size * force_max_N:.0f} N {ARROWS[eighth]}"
