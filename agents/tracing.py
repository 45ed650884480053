"""Traced functions: many small numpy steps run once on symbols, then as one piece of machine code.

A control law is some sixty operations on small arrays, and the model of an arm some hundred more; numpy spends far more
time on each than the arithmetic takes. Tracing keeps the equations as they are written: the same functions run once on
arrays of symbols, what they did to the single numbers is kept as one flat list, in which nothing is done twice, and
that list is compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from math import cos, prod, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.machine_code import Step, compiled

Array = NDArray[np.float64]

OF_NUMBERS: Mapping[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "abs": abs,
    "sin": sin,
    "cos": cos,
    "sqrt": sqrt,
}


class Tape:
    """What was done so far. A number that is known, or was worked out before, costs nothing."""

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self._known: dict[tuple[Any, ...], Symbol] = {}

    def do(self, kind: str, *operands: object) -> Symbol | float:
        """The result of an operation on symbols and numbers."""
        known = [operand if isinstance(operand, Symbol) else float(operand) for operand in operands]  # type: ignore[arg-type]  # raises by itself
        if not any(isinstance(operand, Symbol) for operand in known):
            return OF_NUMBERS[kind](*known)
        short = _shortened(kind, *known)
        if short is None:
            short = self._without_minus(kind, *known)
        if short is not None:
            return short
        slots = tuple(self.slot(operand) for operand in known)
        if kind in ("add", "mul"):
            slots = tuple(sorted(slots))
        return self.keep(kind, slots)

    def _without_minus(self, kind: str, a: Symbol | float, b: Symbol | float = 1.0) -> Symbol | float | None:
        """The same with the minus signs of its operands taken out, exactly: so more of it was done before."""
        minus_a, minus_b = self._negated(a), self._negated(b)
        if kind == "neg":
            return minus_a
        if kind in ("mul", "div") and minus_a is not None:
            return self.do("neg", self.do(kind, minus_a, b))
        if kind in ("mul", "div") and minus_b is not None:
            return self.do("neg", self.do(kind, a, minus_b))
        if kind in ("add", "sub") and minus_b is not None:
            return self.do("sub" if kind == "add" else "add", a, minus_b)
        if kind == "add" and minus_a is not None:
            return self.do("sub", b, minus_a)
        return None

    def _negated(self, value: Symbol | float) -> Symbol | float | None:
        """What this value is minus of, if it is known as that."""
        if not isinstance(value, Symbol):
            return -value if value < 0.0 else None
        step = self.steps[value.slot]
        return Symbol(self, int(step.operands[0])) if step.kind == "neg" else None

    def slot(self, value: Symbol | float) -> int:
        """Where a value is."""
        return value.slot if isinstance(value, Symbol) else self.keep("const", (value,)).slot

    def keep(self, kind: str, operands: tuple[float, ...]) -> Symbol:
        """A step, unless it was done before."""
        done = kind, operands
        if done not in self._known:
            self._known[done] = Symbol(self, len(self.steps))
            self.steps.append(Step(kind, len(self.steps), operands))
        return self._known[done]

    def leading_to(self, slots: Collection[int]) -> list[Step]:
        """The steps that these values depend on."""
        needed = set(slots)
        for step in reversed(self.steps):
            if step.result in needed and step.kind not in ("const", "input"):
                needed.update(int(operand) for operand in step.operands)
        return [step for step in self.steps if step.result in needed]


def _shortened(kind: str, a: Symbol | float, b: Symbol | float = 1.0) -> Symbol | float | None:
    """What needs no operation: with numbers that are finite, nothing changes by it but the sign of a zero."""
    if kind == "mul":
        if a == 0.0 or b == 0.0:
            return 0.0
        if a == 1.0:
            return b
    if kind in ("mul", "div") and b == 1.0:
        return a
    if kind == "div" and a == 0.0:
        return 0.0
    if kind == "add" and a == 0.0:
        return b
    if kind in ("add", "sub") and b == 0.0:
        return a
    if kind == "sub" and a == 0.0 and isinstance(b, Symbol):
        return -b
    return None


class Symbol:
    """A number that is not known yet. Arrays of it (dtype object) go through numpy's arithmetic and ``@``."""

    __slots__ = ("slot", "tape")

    def __init__(self, tape: Tape, slot: int) -> None:
        self.tape, self.slot = tape, slot

    def __add__(self, other: object) -> Symbol | float:
        return self.tape.do("add", self, other)

    def __sub__(self, other: object) -> Symbol | float:
        return self.tape.do("sub", self, other)

    def __mul__(self, other: object) -> Symbol | float:
        return self.tape.do("mul", self, other)

    def __truediv__(self, other: object) -> Symbol | float:
        return self.tape.do("div", self, other)

    def __radd__(self, other: object) -> Symbol | float:
        return self.tape.do("add", other, self)

    def __rsub__(self, other: object) -> Symbol | float:
        return self.tape.do("sub", other, self)

    def __rmul__(self, other: object) -> Symbol | float:
        return self.tape.do("mul", other, self)

    def __rtruediv__(self, other: object) -> Symbol | float:
        return self.tape.do("div", other, self)

    def __pow__(self, power: object) -> Symbol | float:
        if power != 2:
            raise TypeError(f"power of a symbol: got {power!r}, expected 2")
        return self.tape.do("mul", self, self)

    def __neg__(self) -> Symbol | float:
        return self.tape.do("neg", self)

    def __abs__(self) -> Symbol | float:
        return self.tape.do("abs", self)

    def sin(self) -> Symbol | float:
        """What ``np.sin`` asks each element for."""
        return self.tape.do("sin", self)

    def cos(self) -> Symbol | float:
        """Likewise."""
        return self.tape.do("cos", self)

    def sqrt(self) -> Symbol | float:
        """Likewise."""
        return self.tape.do("sqrt", self)


class Traced:
    """A function of small arrays, traced.

    Write into ``inputs``, call, read ``outputs``: the arrays stay the same ones, so nothing is allocated in between.

    Args:
        function: takes one array per name in ``shapes``, by name, and returns arrays of one dimension. No branch of it
            may depend on their values.
        shapes: shape of each input, in order.

    Raises:
        TypeError, ValueError: the function does something that symbols cannot do (a comparison, a numpy function
            without a meaning for objects).
    """

    def __init__(
        self, function: Callable[..., tuple[NDArray[Any], ...]], shapes: Mapping[str, tuple[int, ...]]
    ) -> None:
        tape, places = Tape(), iter(range(sum(map(prod, shapes.values()))))
        given = {
            name: np.array([tape.keep("input", (next(places),)) for _ in range(prod(shape))], dtype=object)
            for name, shape in shapes.items()
        }
        results = function(**{name: given[name].reshape(shape) for name, shape in shapes.items()})
        slots = [tape.slot(value) for result in results for value in result.tolist()]
        read, written = np.zeros(sum(map(prod, shapes.values()))), np.zeros(len(slots))
        self.inputs = {
            name: part.reshape(shape)
            for (name, shape), part in zip(shapes.items(), _parts(read, map(prod, shapes.values())), strict=True)
        }
        self.outputs = list(_parts(written, map(len, results)))
        steps = tape.leading_to(slots) + [Step("output", place, (slot,)) for place, slot in enumerate(slots)]
        self.operations = len(steps)
        """Number of steps, reading and writing included."""
        self._run = compiled(steps, read, written)

    def __call__(self) -> None:
        """Work out ``outputs`` from ``inputs``."""
        self._run()


def _parts(array: Array, lengths: Iterable[int]) -> Iterator[Array]:
    """Neighbouring views of an array."""
    start = 0
    for length in lengths:
        yield array[start : start + length]
        start += length
