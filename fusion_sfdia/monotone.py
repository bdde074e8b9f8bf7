"""Bounds of an explicit equation y = f(x_1, ..., x_n) over a box, from the signs of its partial derivatives.

Where df/dx_i keeps its sign over the whole box (proved with interval derivatives, not looked at in one point), f is least
and greatest at an end of x_i; with every sign proved the bounds are two corners, tight to rounding (Moore, Kearfott and
Cloud 2009, ch. 6).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fusion_sfdia.expression import Expression, record
from fusion_sfdia.interval import Interval, select


def gradient(expression: Expression, values: Sequence[Interval]) -> list[Interval]:
    """Return d f / d x_i over the box that the values of `expression.evaluate` belong to, accumulated backward.

    Where f has a kink (abs, minimum, maximum) it holds every slope. Valid where f is defined on the whole box.
    """
    zero = Interval(0.0)
    slopes = [zero] * len(values)
    slopes[expression.outputs[0]] = Interval(1.0)
    for i, ufunc, operands in reversed(expression.operations):
        if slopes[i] is zero:
            continue
        for k, derivative in zip(operands, DERIVATIVES[ufunc], strict=True):
            if not expression.is_constant(k):
                term = slopes[i] * derivative(values[i], *(values[j] for j in operands))
                slopes[k] = term if slopes[k] is zero else slopes[k] + term
    return slopes[: expression.n_arguments]


def monotone_hull(function: Callable[..., Any] | Expression, box: Interval) -> Interval:
    """Return an enclosure (...) of {function(x_1, ..., x_n): x in box}; box: (..., n).

    A variable whose sign is not proved stays an interval; the result is cut to the natural inclusion and to the mean-value
    form f(m) + sum_i f_i([x]) ([x_i] - m_i). Where f is not defined on the whole box it is the natural inclusion.

    Raises ValueError for another number of variables than the function's, or of results than one.
    """
    x = [box[..., i] for i in range(box.shape[-1])]
    expression = record(function, len(x))
    if len(expression.outputs) != 1:
        raise ValueError(f"a function of {len(expression.outputs)} results: bound one at a time")
    out = expression.outputs[0]
    values = expression.evaluate(x)
    natural = values[out]
    slopes = gradient(expression, values)

    at_least, at_most = [], []
    for xi, slope in zip(x, slopes, strict=True):
        low, high = Interval.unchecked(xi.lo, xi.lo), Interval.unchecked(xi.hi, xi.hi)
        rises, falls = slope.lo >= 0, slope.hi <= 0
        at_least.append(select(rises, low, select(falls, high, xi)))
        at_most.append(select(rises, high, select(falls, low, xi)))
    ends = expression.evaluate(at_least)[out], expression.evaluate(at_most)[out]
    middle = [Interval.unchecked(xi.mid, xi.mid) for xi in x]
    mean_value = expression.evaluate(middle)[out]
    for xi, m, slope in zip(x, middle, slopes, strict=True):
        mean_value = mean_value + slope * (xi - m)
    tight = natural.intersection(Interval.unchecked(ends[0].lo, ends[1].hi)).intersection(mean_value)
    defined = np.broadcast_to(expression.is_defined(values), box.shape[:-1])
    return select(defined, tight, natural)


def _of_power(z: Interval, x: Interval, y: Interval) -> Interval:
    whole = (y.lo == y.hi) & (y.lo == np.rint(y.lo))  # y - 1 is exact there and stays a whole number
    less_one = Interval(y.lo - 1) if whole.all() else select(whole, Interval.unchecked(y.lo - 1, y.lo - 1), y - 1)
    power: Interval = x**less_one
    slope: Interval = y * power
    return slope


def _step(difference: Interval) -> Interval:
    """0 where the difference is negative, 1 where it is positive, [0, 1] where it may be either."""
    return Interval.unchecked(np.where(difference.lo > 0, 1.0, 0.0), np.where(difference.hi < 0, 0.0, 1.0))


_ONE = Interval(1.0)
# for z = f(x, ...): the partial derivative by each argument, as a function of (z, x, ...)
DERIVATIVES: dict[np.ufunc, tuple[Callable[..., Interval], ...]] = {
    np.positive: (lambda z, x: _ONE,),
    np.negative: (lambda z, x: -_ONE,),
    np.add: (lambda z, x, y: _ONE, lambda z, x, y: _ONE),
    np.subtract: (lambda z, x, y: _ONE, lambda z, x, y: -_ONE),
    np.multiply: (lambda z, x, y: y, lambda z, x, y: x),
    np.divide: (lambda z, x, y: 1 / y, lambda z, x, y: -z / y),
    np.reciprocal: (lambda z, x: -np.square(z),),
    np.power: (_of_power, lambda z, x, y: z * np.log(x)),
    np.square: (lambda z, x: 2 * x,),
    np.absolute: (lambda z, x: 2 * _step(x) - 1,),
    np.minimum: (lambda z, x, y: _step(y - x), lambda z, x, y: _step(x - y)),
    np.maximum: (lambda z, x, y: _step(x - y), lambda z, x, y: _step(y - x)),
    np.sqrt: (lambda z, x: 0.5 / z,),
    np.exp: (lambda z, x: z,),
    np.expm1: (lambda z, x: np.exp(x),),
    np.log: (lambda z, x: 1 / x,),
    np.log10: (lambda z, x: 1 / (x * np.log(Interval(10.0))),),
    np.log1p: (lambda z, x: 1 / (1 + x),),
    np.tanh: (lambda z, x: 1 - np.square(z),),
    np.arctanh: (lambda z, x: 1 / (1 - np.square(x)),),
    np.sin: (lambda z, x: np.cos(x),),
    np.cos: (lambda z, x: -np.sin(x),),
}
