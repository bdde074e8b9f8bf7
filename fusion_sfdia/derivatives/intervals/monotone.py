"""Bounds of an explicit equation y = f(x_1, ..., x_n) over a box, from the signs of its partial derivatives.

Where df/dx_i has one sign over the whole box (proved with interval derivatives, not checked at one point), f is smallest and
largest at an end of x_i. With every sign proved the bounds are the values at two corners, tight to rounding (Moore, Kearfott
and Cloud 2009, ch. 6).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.intervals.expression import Expression, record
from fusion_sfdia.derivatives.intervals.interval import Interval, select

Array = NDArray[Any]


def gradient(expression: Expression, values: Sequence[Interval], argument: int | None = None) -> list[Interval]:
    """Return d f / d x_i over the box that the values of `expression.evaluate` belong to, accumulated backward.

    At a kink of f (abs, minimum, maximum) it contains every slope. Valid where f is defined on the whole box. argument: the
    only one whose slope is computed, None for all.
    """
    zero = Interval(0.0)
    slopes = [zero] * len(values)
    slopes[expression.outputs[0]] = _ONE
    varies = expression.depends_on(argument)
    for i, ufunc, operands in reversed(expression.operations):
        if slopes[i] is zero:
            continue
        for k, derivative in zip(operands, DERIVATIVES[ufunc], strict=True):
            if varies[k]:
                term = _times(slopes[i], derivative(values[i], *(values[j] for j in operands)))
                slopes[k] = term if slopes[k] is zero else slopes[k] + term
    return slopes[: expression.n_arguments]


def derivative(expression: Expression, values: Sequence[Interval], argument: int) -> Interval:
    """Return d f / d x_i for one argument over the box of the values, accumulated forward; otherwise as `gradient`."""
    zero = Interval(0.0)
    slopes = [zero] * len(values)
    slopes[argument] = _ONE
    for i, ufunc, operands in expression.operations:
        for k, partial in zip(operands, DERIVATIVES[ufunc], strict=True):
            if slopes[k] is not zero:
                term = _times(slopes[k], partial(values[i], *(values[j] for j in operands)))
                slopes[i] = term if slopes[i] is zero else slopes[i] + term
    return slopes[expression.outputs[0]]


def _times(slope: Interval, factor: Interval) -> Interval:
    """Their product: exact, without outward rounding, where one of them is 1, or the factor -1, by its rule."""
    if factor is _ONE or slope is _ONE:
        return slope if factor is _ONE else factor
    product: Interval = -slope if factor is _MINUS_ONE else slope * factor
    return product


def monotone_hull(function: Callable[..., Any] | Expression, box: Interval, pieces: int = 1) -> Interval:
    """Return an enclosure (...) of {function(x_1, ..., x_n): x in box}; box: (..., n).

    Variables whose sign is proved are set to the end that bounds f, which may prove further signs. For the remaining intervals
    the bounds are the intersection of natural inclusion and mean-value form, f(m) + sum_i f_i([x]) ([x_i] - m_i). Where f is
    not defined on the whole box the result is the natural inclusion.

    Interval derivatives overestimate where a variable occurs several times. With `pieces` > 1 each variable is cut into that
    many parts, which gives pieces^n boxes.

    Raises ValueError for a wrong number of variables, for more than one result, and for pieces < 1.
    """
    x = [box[..., i] for i in range(box.shape[-1])]
    expression = record(function, len(x))
    if len(expression.outputs) != 1:
        raise ValueError(f"the function has {len(expression.outputs)} results; expected 1: bound one at a time")
    if pieces < 1:
        raise ValueError(f"pieces is {pieces}; expected 1 or more parts of each variable")
    found, slopes, defined = _bounds(expression, x, pieces)
    lo, hi = found.lo, found.hi
    for greatest in (False, True):
        end, signs = x, slopes
        for _ in x:
            before, end = end, [_end(xi, -slope if greatest else slope) for xi, slope in zip(end, signs, strict=True)]
            if all(((a.lo == b.lo) & (a.hi == b.hi)).all() for a, b in zip(before, end, strict=True)):
                break
            if all((e.lo == e.hi).all() for e in end):
                there = expression.evaluate(end)[expression.outputs[0]]  # a corner: slopes have no effect
            else:
                there, signs, _ = _bounds(expression, end, pieces)
            lo, hi = (lo, np.minimum(hi, there.hi)) if greatest else (np.maximum(lo, there.lo), hi)
    return select(defined, Interval.unchecked(lo, hi), found)


def _end(x: Interval, slope: Interval) -> Interval:
    """Return the end of x at which a function with this slope is least, or x where the sign is not proved."""
    rises, falls = slope.lo >= 0, slope.hi <= 0
    return select(rises, Interval.unchecked(x.lo, x.lo), select(falls, Interval.unchecked(x.hi, x.hi), x))


def _bounds(expression: Expression, x: Sequence[Interval], pieces: int) -> tuple[Interval, list[Interval], Array]:
    """Return an enclosure of f over x, its slopes, and whether f is defined on all of x."""
    n, batch = len(x), x[0].shape
    parts, out = _parts(x, pieces), expression.outputs[0]
    values = expression.evaluate(parts)
    slopes = gradient(expression, values)
    middle = [Interval.unchecked(part.mid, part.mid) for part in parts]
    mean_value = expression.evaluate(middle)[out]
    for part, m, slope in zip(parts, middle, slopes, strict=True):
        mean_value = mean_value + slope * (part - m)
    defined = expression.is_defined(values)
    tight = select(defined, values[out].intersection(mean_value), values[out])
    everywhere = np.asarray(np.broadcast_to(defined, (pieces,) * n + batch).all(axis=tuple(range(n))))
    return _over_parts(tight, n, batch), [_over_parts(slope, n, batch) for slope in slopes], everywhere


def _parts(x: Sequence[Interval], pieces: int) -> list[Interval]:
    """Return each variable cut into pieces along a leading axis for each variable; neighbouring pieces share their end."""
    parts = []
    for i, xi in enumerate(x):
        share = np.linspace(0.0, 1.0, pieces + 1).reshape(-1, *(1,) * len(xi.shape))
        edges = np.clip(xi.lo + share * (xi.hi - xi.lo), xi.lo, xi.hi)
        edges[0], edges[-1] = xi.lo, xi.hi
        own_axis = (1,) * i + (pieces,) + (1,) * (len(x) - 1 - i) + xi.shape
        parts.append(Interval.unchecked(edges[:-1].reshape(own_axis), edges[1:].reshape(own_axis)))
    return parts


def _over_parts(y: Interval, n: int, batch: tuple[int, ...]) -> Interval:
    """Return the hull over the n axes of the parts."""
    shape = (1,) * (n + len(batch) - len(y.shape)) + y.shape
    axes = tuple(range(n))
    lo, hi = np.fmin.reduce(y.lo.reshape(shape), axis=axes), np.fmax.reduce(y.hi.reshape(shape), axis=axes)
    return Interval.unchecked(np.broadcast_to(lo, batch), np.broadcast_to(hi, batch))


def _of_power(z: Interval, x: Interval, y: Interval) -> Interval:
    whole = (y.lo == y.hi) & (y.lo == np.rint(y.lo))  # y - 1 is exact there and remains an integer
    less_one = Interval(y.lo - 1) if whole.all() else select(whole, Interval.unchecked(y.lo - 1, y.lo - 1), y - 1)
    power: Interval = x**less_one
    slope: Interval = y * power
    return slope


def _step(difference: Interval) -> Interval:
    """0 where the difference is negative, 1 where it is positive, [0, 1] where it may be either."""
    return Interval.unchecked(np.where(difference.lo > 0, 1.0, 0.0), np.where(difference.hi < 0, 0.0, 1.0))


_ONE, _MINUS_ONE = Interval(1.0), Interval(-1.0)
# for z = f(x, ...): the partial derivative by each argument, as a function of (z, x, ...)
DERIVATIVES: dict[np.ufunc, tuple[Callable[..., Interval], ...]] = {
    np.positive: (lambda z, x: _ONE,),
    np.negative: (lambda z, x: _MINUS_ONE,),
    np.add: (lambda z, x, y: _ONE, lambda z, x, y: _ONE),
    np.subtract: (lambda z, x, y: _ONE, lambda z, x, y: _MINUS_ONE),
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
