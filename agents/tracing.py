"""Traced functions: many small numpy steps run once on symbols, then evaluated in one call. The one door to CasADi.

A control law is some sixty operations on small arrays, and numpy spends far more time on each than the arithmetic
takes. Tracing keeps the equations as they are written: the same functions run once on arrays of symbols, and what they
did is kept as one flat list of scalar instructions.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import prod
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Symbol:
    """A number that is not known yet. Arrays of it (dtype object) go through numpy's arithmetic and ``@``."""

    __slots__ = ("expression",)

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    def __add__(self, other: object) -> Symbol:
        return Symbol(self.expression + _expression(other))

    def __sub__(self, other: object) -> Symbol:
        return Symbol(self.expression - _expression(other))

    def __mul__(self, other: object) -> Symbol:
        return Symbol(self.expression * _expression(other))

    def __truediv__(self, other: object) -> Symbol:
        return Symbol(self.expression / _expression(other))

    def __radd__(self, other: object) -> Symbol:
        return Symbol(_expression(other) + self.expression)

    def __rsub__(self, other: object) -> Symbol:
        return Symbol(_expression(other) - self.expression)

    def __rmul__(self, other: object) -> Symbol:
        return Symbol(_expression(other) * self.expression)

    def __rtruediv__(self, other: object) -> Symbol:
        return Symbol(_expression(other) / self.expression)

    def __pow__(self, power: object) -> Symbol:
        return Symbol(self.expression ** _expression(power))

    def __neg__(self) -> Symbol:
        return Symbol(-self.expression)

    def __abs__(self) -> Symbol:
        return Symbol(casadi.fabs(self.expression))


def _expression(value: object) -> Any:
    return value.expression if isinstance(value, Symbol) else float(value)  # type: ignore[arg-type]  # raises by itself


class Traced:
    """A function of small arrays, traced.

    Write into ``inputs``, call, read ``outputs``: the arrays stay the same ones, so nothing is allocated in between.

    Args:
        function: takes one array per name in ``shapes``, by name, and returns arrays of one dimension. No branch of it
            may depend on their values.
        shapes: shape of each input, in order.
        symmetric: inputs that are symmetric matrices: only their upper triangles are read.

    Raises:
        TypeError, ValueError: the function does something that symbols cannot do (a comparison, a numpy function
            without a meaning for objects).
    """

    def __init__(
        self,
        function: Callable[..., tuple[NDArray[Any], ...]],
        shapes: Mapping[str, tuple[int, ...]],
        symmetric: Collection[str] = (),
    ) -> None:
        symbols = {name: casadi.SX.sym(name, prod(shape)) for name, shape in shapes.items()}
        given = {name: _array_of_symbols(symbols[name], shape, name in symmetric) for name, shape in shapes.items()}
        results = function(**given)
        # A result that depends on no input is a plain number, and one that nothing was done to is an input.
        flat = [casadi.vertcat(*(_expression(value) for value in result)) for result in results]
        self.inputs = {name: np.zeros(shape) for name, shape in shapes.items()}
        self.outputs = [np.zeros(len(result)) for result in results]
        traced: Any = casadi.Function("traced", list(symbols.values()), flat, {"cse": True})
        buffer, self._evaluate = traced.buffer()
        self._buffer: Any = buffer
        for index, array in enumerate(self.inputs.values()):
            self._buffer.set_arg(index, array.data)
        for index, array in enumerate(self.outputs):
            self._buffer.set_res(index, array.data)

    def __call__(self) -> None:
        """Work out ``outputs`` from ``inputs``."""
        self._evaluate()


def _array_of_symbols(symbols: Any, shape: tuple[int, ...], symmetric: bool) -> NDArray[np.object_]:
    array = np.array([Symbol(symbols[index]) for index in range(prod(shape))], dtype=object).reshape(shape)
    return np.triu(array) + np.triu(array, 1).T if symmetric else array
