"""What a measurement leaves: figures by row and column, each with all of its samples, and the file that keeps them.

The speed of a shared machine moves by a factor of two from minute to minute. So what is to be compared is measured in
turns, and what counts is the ratio within a turn; those figures have the unit ``x``.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

FORMAT = "palanquin-bench/1"
RATIO = "x"
Better = Literal["more", "less", ""]


class NoBenchFile(Exception):
    """A file that was to be read is none of ours; the message says what is wrong with it."""

    exit_status = 2


@dataclass(frozen=True, slots=True)
class Figure:
    """One number of a table, from one or more turns."""

    row: str
    column: str
    unit: str
    """``x`` for a ratio of two figures of the same turn, else ticks/s, us, ms, s, MB, %, ticks."""
    values: tuple[float, ...]
    """One per turn; at least one."""
    better: Better = ""
    positive: bool = True
    """False for what may be zero or less, such as a number of misses."""

    @property
    def value(self) -> float:
        """Median over the turns."""
        return statistics.median(self.values)

    @property
    def low(self) -> float:
        """The least of the turns."""
        return min(self.values)

    @property
    def high(self) -> float:
        """The greatest."""
        return max(self.values)

    def as_fields(self) -> dict[str, Any]:
        """For JSON: what the figure is, its median, its range and all samples."""
        return {
            "row": self.row,
            "column": self.column,
            "unit": self.unit,
            "better": self.better,
            "positive": self.positive,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "values": list(self.values),
        }


@dataclass(frozen=True, slots=True)
class Part:
    """What one part of the bench found."""

    name: str
    title: str
    figures: tuple[Figure, ...]
    said: tuple[str, ...] = ()
    """Sentences: how to read it, and what was left out, and why."""
    wall_s: float = 0.0

    def as_fields(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "title": self.title,
            "wall_s": self.wall_s,
            "said": list(self.said),
            "figures": [figure.as_fields() for figure in self.figures],
        }


@dataclass(slots=True)
class Samples:
    """Collects samples of figures, turn by turn, in the order in which they first come."""

    _values: dict[tuple[str, str, str, Better, bool], list[float]] = field(default_factory=dict)

    def add(
        self, row: str, column: str, unit: str, value: float, better: Better = "", *, positive: bool = True
    ) -> None:
        """One sample of one figure."""
        self._values.setdefault((row, column, unit, better, positive), []).append(float(value))

    def ratio(self, row: str, column: str, above: float, below: float, better: Better = "") -> None:
        """One sample of a ratio; none where nothing was measured below."""
        if below > 0:
            self.add(row, column, RATIO, above / below, better)

    def figures(self) -> tuple[Figure, ...]:
        """All of them."""
        return tuple(
            Figure(row, column, unit, tuple(values), better, positive)
            for (row, column, unit, better, positive), values in self._values.items()
        )


def as_file(machine: dict[str, Any], settings: dict[str, Any], parts: Iterable[Part]) -> dict[str, Any]:
    """The whole content of a bench's file."""
    return {
        "format": FORMAT,
        "machine": machine,
        "settings": settings,
        "parts": {part.name: part.as_fields() for part in parts},
    }


def read_file(path: Path) -> tuple[dict[str, Any], dict[str, Part]]:
    """The machine and the parts of a file that ``palanquin bench --out`` wrote.

    Raises:
        NoBenchFile: it cannot be read, or is something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise NoBenchFile(f"{path} cannot be read ({error.strerror}): expected a file of `palanquin bench`") from None
    except ValueError as error:
        raise NoBenchFile(f"{path} is no JSON ({error}): expected a file of `palanquin bench --out`") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        got = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise NoBenchFile(f"{path}: format {got!r}, expected {FORMAT!r}: a file of `palanquin bench --out`")
    try:
        parts = {name: _part(name, fields) for name, fields in content["parts"].items()}
        machine = dict(content["machine"])
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise NoBenchFile(f"{path}: not whole ({type(error).__name__}: {error}): run the bench again") from None
    return machine, parts


def _part(name: str, fields: dict[str, Any]) -> Part:
    figures = tuple(_figure(each) for each in fields["figures"])
    return Part(name, str(fields["title"]), figures, tuple(map(str, fields["said"])), float(fields["wall_s"]))


def _figure(fields: dict[str, Any]) -> Figure:
    values = tuple(map(float, fields["values"]))
    if not values or not all(map(math.isfinite, values)):
        raise ValueError(f"figure {fields['row']!r}: got {list(values)}, expected at least one number, all finite")
    return Figure(
        str(fields["row"]),
        str(fields["column"]),
        str(fields["unit"]),
        values,
        fields["better"],
        bool(fields["positive"]),
    )


def percentile(values: Sequence[float], percent: float) -> float:
    """The smallest value with at least this part of all at or below it."""
    ordered = sorted(values)
    return ordered[max(0, math.ceil(len(ordered) * percent / 100) - 1)]
