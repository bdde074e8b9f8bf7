"""Forward-backward contraction (HC4-revise; Benhamou, Goualard, Granvilliers and Puget 1999).

An equation's values are computed forward; a bound on its result is then projected backward through each operation onto
its arguments. The removed part contains no solution: all arguments in the box whose result is in the target remain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fusion_sfdia.derivatives.intervals.expression import Expression
from fusion_sfdia.derivatives.intervals.interval import Interval, select

POSITIVE = Interval(0.0, np.inf)
NEGATIVE = Interval(-np.inf, 0.0)


def backward(expression: Expression, values: Sequence[Interval], targets: Sequence[Interval]) -> list[Interval]:
    """Return the arguments that remain when each result is restricted to its target; all are empty without a solution.

    `values` are those of `expression.evaluate`; targets broadcast against them, one for each output.
    """
    kept = list(values)
    for i, target in zip(expression.outputs, targets, strict=True):
        kept[i] = kept[i].intersection(target)
    for i, ufunc, operands in reversed(expression.operations):
        before = [kept[k] for k in operands]
        for k, project in zip(operands, PROJECTIONS[ufunc], strict=True):
            if not expression.is_constant(k):
                kept[k] = kept[k].intersection(project(kept[i], *before))
    none = np.any(np.broadcast_arrays(*(x.is_empty for x in kept)), axis=0)
    return [select(none, Interval.empty(), x) for x in kept[: expression.n_arguments]]


def factor(z: Interval, x: Interval, y: Interval) -> Interval:
    """Return the x with x y in z for a y in [y]; two pieces, each cut to [x], where [y] contains zero and z does not."""
    through_zero = y.contains(0.0)
    if not through_zero.any():
        return x.intersection(z / y)
    pieces = [x.intersection(z / y.intersection(side)) for side in (NEGATIVE, POSITIVE)]
    return select(through_zero & z.contains(0.0), x, pieces[0].hull(pieces[1]))


def both_signs(magnitude: Interval, x: Interval) -> Interval:
    """Return the part of [x] whose magnitude is in the given interval."""
    return x.intersection(magnitude).hull(x.intersection(-magnitude))


def base(z: Interval, x: Interval, y: Interval) -> Interval:
    """Return the x with x^y in z; only for an exponent that is a single number."""
    if y.shape or y.lo != y.hi:
        return x
    n = float(y.lo)
    if n == 0:
        return select(z.contains(1.0), x, Interval.empty())

    def root(part: Interval) -> Any:
        return np.sqrt(part) if n == 2 else part.intersection(POSITIVE) ** (Interval(1.0) / n)

    if not n.is_integer():
        return x.intersection(root(z))
    if n % 2 == 0:
        return both_signs(root(z), x)
    return x.intersection(root(z)).hull(x.intersection(-root(-z)))


def exponent(z: Interval, x: Interval, y: Interval) -> Interval:
    """Return the y with x^y in z, for x > 0: y log x = log z."""
    log_z: Any = np.log(z)
    log_x: Any = np.log(x)
    return select(x.lo > 0, factor(log_z, y, log_x), y)


def of_minimum(z: Interval, x: Interval, y: Interval) -> Interval:
    """Return the x with min(x, y) in z: at least the lower end of z, and in z where y is certainly above z."""
    return select(y.lo > z.hi, z, Interval.unchecked(z.lo, z.hi + np.inf))


def of_maximum(z: Interval, x: Interval, y: Interval) -> Interval:
    """Return the x with max(x, y) in z."""
    negated: Interval = -of_minimum(-z, -x, -y)
    return negated


# for z = f(x, ...): one function of (z, x, ...) for each argument, which returns its remaining values
PROJECTIONS: dict[np.ufunc, tuple[Callable[..., Interval], ...]] = {
    np.positive: (lambda z, x: z,),
    np.negative: (lambda z, x: -z,),
    np.add: (lambda z, x, y: z - y, lambda z, x, y: z - x),
    np.subtract: (lambda z, x, y: z + y, lambda z, x, y: x - z),
    np.multiply: (factor, lambda z, x, y: factor(z, y, x)),
    np.divide: (lambda z, x, y: z * y, lambda z, x, y: factor(x, y, z)),
    np.reciprocal: (lambda z, x: factor(Interval(1.0), x, z),),
    np.power: (base, exponent),
    np.square: (lambda z, x: both_signs(np.sqrt(z), x),),
    np.absolute: (lambda z, x: both_signs(z.intersection(POSITIVE), x),),
    np.minimum: (of_minimum, lambda z, x, y: of_minimum(z, y, x)),
    np.maximum: (of_maximum, lambda z, x, y: of_maximum(z, y, x)),
    np.sqrt: (lambda z, x: np.square(z.intersection(POSITIVE)),),
    np.exp: (lambda z, x: np.log(z),),
    np.expm1: (lambda z, x: np.log1p(z),),
    np.log: (lambda z, x: np.exp(z),),
    np.log10: (lambda z, x: 10.0**z,),
    np.log1p: (lambda z, x: np.expm1(z),),
    np.tanh: (lambda z, x: np.arctanh(z),),
    np.arctanh: (lambda z, x: np.tanh(z),),
    np.sin: (lambda z, x: x,),  # many branches: sin and cos are evaluated, but not projected back
    np.cos: (lambda z, x: x,),
}
