"""The expression of an equation, recorded by running the equation once on symbols.

The recorded operations serve to project a bound of the result back onto the arguments (`contractors`), to form partial
derivatives (`monotone`), and to determine whether the result is defined on a whole box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.interval_kernels import KERNELS

Array = NDArray[Any]


@dataclass(frozen=True)
class Expression:
    """Slots of values in order of computation: first the arguments, then constants and operations.

    `slots[i]` is a constant (an Interval) or an operation (ufunc, indices of its arguments); the first `n_arguments` are
    None. `outputs` are the indices of the results.
    """

    n_arguments: int
    slots: tuple[Any, ...]
    outputs: tuple[int, ...]

    @property
    def operations(self) -> list[tuple[int, np.ufunc, tuple[int, ...]]]:
        """Index, function and arguments of each operation, in order."""
        return [(i, *slot) for i, slot in enumerate(self.slots) if isinstance(slot, tuple)]

    def is_constant(self, index: int) -> bool:
        return isinstance(self.slots[index], Interval)

    def depends_on(self, argument: int | None) -> list[bool]:
        """Whether the value of each slot depends on an argument; on any of them where that is None."""
        found = [i < self.n_arguments and argument in (None, i) for i in range(len(self.slots))]
        for i, _, operands in self.operations:
            found[i] = any(found[k] for k in operands)
        return found

    def evaluate(self, arguments: Sequence[Interval]) -> list[Interval]:
        """Return the value of every slot: the natural inclusion of each intermediate result."""
        if len(arguments) != self.n_arguments:
            raise ValueError(f"{len(arguments)} arguments; expected the {self.n_arguments} of the expression")
        values: list[Any] = [*arguments, *self.slots[self.n_arguments :]]
        for i, ufunc, operands in self.operations:
            values[i] = ufunc(*(values[k] for k in operands))
        return values

    def is_defined(self, values: Sequence[Interval]) -> Array:
        """Return whether each operation is defined on all of its arguments' intervals; values: those of `evaluate`."""
        defined = np.ones((), dtype=bool)
        for _, ufunc, operands in self.operations:
            if ufunc in DOMAINS:
                defined = defined & DOMAINS[ufunc](*(values[k] for k in operands))
        return defined


DOMAINS: dict[np.ufunc, Callable[..., Array]] = {
    np.divide: lambda x, y: (y.lo > 0) | (y.hi < 0),
    np.reciprocal: lambda x: (x.lo > 0) | (x.hi < 0),
    np.sqrt: lambda x: x.lo >= 0,
    np.log: lambda x: x.lo > 0,
    np.log10: lambda x: x.lo > 0,
    np.log1p: lambda x: x.lo > -1,
    np.arctanh: lambda x: (x.lo > -1) & (x.hi < 1),
    np.power: lambda x, y: (
        (x.lo > 0) | ((x.lo >= 0) & (y.lo > 0)) | ((y.lo == y.hi) & (y.lo == np.rint(y.lo)) & ((y.lo >= 0) | (x.hi < 0)))
    ),
}


class IntervalSymbol(NDArrayOperatorsMixin):
    """A slot during recording: an operation on it adds a slot."""

    __slots__ = ("index", "slots")

    def __init__(self, slots: list[Any], slot: Any) -> None:
        self.slots, self.index = slots, len(slots)
        slots.append(slot)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if kwargs.get("out") == (inputs[0],):  # x += y, which binds x to a new slot
            del kwargs["out"]
        if method != "__call__" or kwargs or ufunc not in KERNELS:
            raise TypeError(f"{ufunc.__name__} is not available for equations on intervals")
        operands = tuple(x.index if isinstance(x, IntervalSymbol) else add_constant(self.slots, x) for x in inputs)
        return IntervalSymbol(self.slots, (ufunc, operands))


def add_constant(slots: list[Any], x: Any) -> int:
    """Add a constant to the slots and return its index."""
    value = x if isinstance(x, Interval) else Interval(x)
    if value.shape:
        raise ValueError(f"an array of shape {value.shape} inside an equation: pass it as an argument of the equation")
    slots.append(value)
    return len(slots) - 1


def record(function: Callable[..., Any] | Expression, n_arguments: int) -> Expression:
    """Return the expression of an equation of `n_arguments` scalars that returns one result or a tuple of them.

    An expression is returned unchanged, so that an equation that is used often can be recorded once.

    Raises ValueError where the equation takes another number of arguments, or contains an array instead of a scalar.
    """
    if isinstance(function, Expression):
        expression = function
    else:
        slots: list[Any] = []
        arguments = [IntervalSymbol(slots, None) for _ in range(n_arguments)]
        try:
            results = function(*arguments)
        except TypeError as error:
            raise ValueError(f"{function!r} does not run on {n_arguments} symbols: {error}") from error
        results = results if isinstance(results, tuple) else (results,)
        outputs = tuple(x.index if isinstance(x, IntervalSymbol) else add_constant(slots, x) for x in results)
        expression = Expression(n_arguments, tuple(slots), outputs)
    if expression.n_arguments != n_arguments:
        raise ValueError(f"the equation has {expression.n_arguments} arguments, the box and its parameters {n_arguments}")
    return expression
