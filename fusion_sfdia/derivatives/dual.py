"""Dual numbers in compiled code: a value and its slope, the derivative along one direction, by the rules of differentiation.

An equation takes them in place of numbers, as it takes complex ones; but their rules have no branches and fewer operations, so
that loops over them become vector instructions:

    (a, a') (b, b') = (a b, a' b + a b'),    (a, a') / (b, b') = (q, (a' - q b') / b)  with q = a / b

The values have the bits that the equation has with numbers. An operation takes dual numbers and floats, not integers.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, make_attribute_wrapper, models, overload, register_model

Rule = Callable[..., Any]


class Dual(types.Type):  # type: ignore[misc]  # numba has no types
    """The type of dual numbers."""

    def __init__(self) -> None:
        super().__init__(name="Dual")


DUAL = Dual()


@register_model(Dual)
class _Pair(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, [("value", types.float64), ("slope", types.float64)])


make_attribute_wrapper(Dual, "value", "value")
make_attribute_wrapper(Dual, "slope", "slope")


def _paired(context: Any, builder: Any, value: Any, slope: Any) -> Any:
    pair = cgutils.create_struct_proxy(DUAL)(context, builder)
    pair.value, pair.slope = value, slope
    return pair._getvalue()


@intrinsic  # type: ignore[untyped-decorator]
def dual(context: Any, value: Any, slope: Any) -> Any:
    """The dual number of a value and a slope."""
    return DUAL(types.float64, types.float64), lambda context, builder, _, given: _paired(context, builder, *given)


class _Term(NamedTuple):
    """A float in the code that is being built."""

    builder: Any
    term: Any

    def __add__(self, other: Any) -> _Term:
        return _Term(self.builder, self.builder.fadd(self.term, other.term))

    def __sub__(self, other: Any) -> _Term:
        return _Term(self.builder, self.builder.fsub(self.term, other.term))

    def __mul__(self, other: Any) -> _Term:
        return _Term(self.builder, self.builder.fmul(self.term, other.term))

    def __truediv__(self, other: Any) -> _Term:
        return _Term(self.builder, self.builder.fdiv(self.term, other.term))

    def __neg__(self) -> _Term:
        return _Term(self.builder, self.builder.fneg(self.term))


class _Slopes(AbstractTemplate):  # type: ignore[misc]
    """An operation is one of dual numbers where one of its operands is, and the other a float."""

    def generic(self, given: Any, named: Any) -> Any:
        if DUAL in given and all(kind in (DUAL, types.float64) for kind in given):
            return signature(DUAL, *given)
        return None


def _define(operation: Callable[..., Any], kinds: tuple[Any, ...], rule: Rule) -> None:
    """Define the value and the slope of an operation on such operands: each its value and slope, or the float."""

    @lower_builtin(operation, *kinds)  # type: ignore[untyped-decorator]
    def built(context: Any, builder: Any, _: Any, given: Any) -> Any:
        operands = []
        for kind, operand in zip(kinds, given, strict=True):
            parts = [builder.extract_value(operand, i) for i in (0, 1)] if kind is DUAL else [operand]
            operands += [_Term(builder, part) for part in parts]
        value, slope = rule(*operands)
        return _paired(context, builder, value.term, slope.term)


for _operation, _both, _first, _second in (
    (operator.add, lambda a, da, b, db: (a + b, da + db), lambda a, da, b: (a + b, da), lambda a, b, db: (a + b, db)),
    (operator.sub, lambda a, da, b, db: (a - b, da - db), lambda a, da, b: (a - b, da), lambda a, b, db: (a - b, -db)),
    (
        operator.mul,
        lambda a, da, b, db: (a * b, da * b + a * db),
        lambda a, da, b: (a * b, da * b),
        lambda a, b, db: (a * b, a * db),
    ),
    (
        operator.truediv,
        lambda a, da, b, db: (a / b, (da - a / b * db) / b),
        lambda a, da, b: (a / b, da / b),
        lambda a, b, db: (a / b, -(a / b * db) / b),
    ),
):
    infer_global(_operation)(type(f"_Slopes_{_operation.__name__}", (_Slopes,), {}))
    _define(_operation, (DUAL, DUAL), _both)
    _define(_operation, (DUAL, types.float64), _first)
    _define(_operation, (types.float64, DUAL), _second)

infer_global(operator.neg)(type("_Slopes_neg", (_Slopes,), {}))
_define(operator.neg, (DUAL,), lambda a, da: (-a, -da))


@overload(np.log)
def _log(x):  # type: ignore[no-untyped-def]
    return (lambda x: dual(np.log(x.value), x.slope / x.value)) if x is DUAL else None


@overload(np.sqrt)
def _sqrt(x):  # type: ignore[no-untyped-def]
    return (lambda x: dual(np.sqrt(x.value), 0.5 * x.slope / np.sqrt(x.value))) if x is DUAL else None


@overload(np.exp)
def _exp(x):  # type: ignore[no-untyped-def]
    return (lambda x: dual(np.exp(x.value), np.exp(x.value) * x.slope)) if x is DUAL else None


@overload(np.maximum)
def _maximum(x, least):  # type: ignore[no-untyped-def]
    at_least = lambda x, least: dual(np.maximum(x.value, least), x.slope if x.value >= least else 0.0)  # noqa: E731
    return at_least if x is DUAL and least == types.float64 else None


@overload(operator.pow)
def _power(x, by):  # type: ignore[no-untyped-def]
    """Of a positive number to a constant power."""
    return (lambda x, by: dual(x.value**by, by * x.value**by / x.value * x.slope)) if x is DUAL else None
