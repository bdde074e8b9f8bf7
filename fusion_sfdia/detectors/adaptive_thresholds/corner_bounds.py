"""Bounds of explicit equations over boxes from two corners; the signs of slopes are proved once, over an envelope.

Over the envelope, a box that contains all healthy readings, interval derivatives prove the sign of each partial derivative
of each equation, or else bound its magnitude. Inside the envelope an equation f lies between its corners

    f(m_i - s_i r_i) - sum_j G_j r_j   and   f(m_i + s_i r_i) + sum_j G_j r_j

for the box of middle m and radius r, where s_i = +-1 is the sign of the slope and G_i = 0. If the sign is not proved,
l <= df/dx_i <= h with l < 0 < h, there are two choices: s_i is the sign of the larger of -l and h, and G_i is twice the
smaller; or s_i = 0 and G_i is the larger. The mean value theorem, applied to one variable after the other, proves both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.intervals.expression import record
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.monotone import derivative, gradient
from fusion_sfdia.detectors.adaptive_thresholds.monitoring import quantities_of

Array = NDArray[Any]
Equations = Mapping[str, Callable[..., Any]]

NEGLIGIBLE = 1e-12  # share of the slope of the other sign that counts as rounding, where a slope is 0 at an end of a box
TRIED = 64  # sample of boxes on which the side to halve is chosen
BOXES = 4096  # into which an envelope is cut at most to prove the signs of one equation


def slopes(function: Callable[..., Any], low: Array, high: Array, budget: int = BOXES) -> tuple[Array, Array]:
    """Return guaranteed lower and upper bounds (n,) of the partial derivatives of a function of n scalars over a box.

    For each argument in turn, boxes where the sign of the slope is not proved are halved along the side that narrows the bounds
    the most. This ends when the sign is proved up to NEGLIGIBLE, both signs have occurred, or `budget` boxes have been used.
    """
    expression = record(function, n := len(low))

    def bounds(lo: Array, hi: Array, argument: int) -> tuple[Array, Array]:
        values = expression.evaluate([Interval(lo[:, i], hi[:, i]) for i in range(n)])
        # they overestimate differently: backward multiplies by the outer slopes first, forward by the inner ones
        found = gradient(expression, values, argument)[argument].intersection(derivative(expression, values, argument))
        return np.broadcast_to(found.lo, len(lo)), np.broadcast_to(found.hi, len(lo))

    whole = gradient(expression, expression.evaluate([Interval(lo, hi) for lo, hi in zip(low, high, strict=True)]))
    least, most = np.array([float(g.lo) for g in whole]), np.array([float(g.hi) for g in whole])
    for k in np.flatnonzero(~((least >= 0) | (most <= 0))):
        least[k], most[k] = _slope(partial(bounds, argument=int(k)), low, high, budget)
    return least, most


def _slope(bounds: Callable[[Array, Array], tuple[Array, Array]], low: Array, high: Array, budget: int) -> tuple[float, float]:
    """Lower and upper bound of one slope."""
    least, most = np.inf, -np.inf  # over the boxes that need no further cut
    falls = rises = False  # somewhere
    lo, hi, spent = low[None], high[None], 0
    below, above = bounds(lo, hi)
    while True:
        spent += len(lo)
        is_falling, is_rising = (below < 0) & (above <= -NEGLIGIBLE * below), (above > 0) & (-below <= NEGLIGIBLE * above)
        falls, rises = falls or bool(np.any(is_falling)), rises or bool(np.any(is_rising))
        is_open = (below < 0) & (above > 0) & ~is_falling & ~is_rising
        if (falls and rises) or not np.any(is_open) or spent + 2 * int(is_open.sum()) > budget:
            return min(least, float(below.min())), max(most, float(above.max()))
        if not np.all(is_open):
            least, most = min(least, float(below[~is_open].min())), max(most, float(above[~is_open].max()))
        lo, hi = lo[is_open], hi[is_open]
        some = slice(None, None, max(1, len(lo) // TRIED))
        parts = [_halved(lo[some], hi[some], side) for side in range(lo.shape[1])]
        tried = bounds(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]))
        left = np.maximum(np.minimum(tried[1], -tried[0]), 0.0).reshape(len(parts), -1)
        side = int(np.argmin(left.sum(axis=1)))
        if some.step == 1:
            (lo, hi), (below, above) = parts[side], (t.reshape(len(parts), -1)[side] for t in tried)
        else:
            lo, hi = _halved(lo, hi, side)
            below, above = bounds(lo, hi)


def _halved(lo: Array, hi: Array, side: int) -> tuple[Array, Array]:
    """Halve each box (M, n) along a side."""
    left, right = hi.copy(), lo.copy()
    left[:, side] = right[:, side] = (lo[:, side] + hi[:, side]) / 2
    return np.concatenate([lo, right]), np.concatenate([left, hi])


@dataclass(frozen=True)
class Slopes:
    """Slopes of E equations by V variables.

    signs (E, V): s, -1, 0 or 1. unproved (E, V): the slack G where a sign is not proved. size (E, V): a bound of |derivative|,
    a Lipschitz constant for each variable; 0 where an equation does not contain the variable.
    """

    signs: Array
    unproved: Array
    size: Array


def prove(equations: Equations, variables: Sequence[str], low: Array, high: Array, c: Any, budget: int = BOXES) -> Slopes:
    """Prove the slopes of equations of the named variables over the envelope low..high (V,); c: their parameters.

    Raises ValueError for an envelope that is not a box.
    """
    if not np.all((low < high) & np.isfinite(low) & np.isfinite(high)):
        wrong = [v for v, a, b in zip(variables, low, high, strict=True) if not (np.isfinite(a) and np.isfinite(b) and a < b)]
        raise ValueError(f"the envelope of {', '.join(wrong)} is not a finite range; expected low < high")
    proved: Callable[..., tuple[Array, Array]] = _proved
    try:
        hash(c)
    except TypeError:  # parameters that contain arrays: proved each time
        proved = _proved.__wrapped__
    shape = len(equations), len(variables)
    signs, unproved, size = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for e, (name, function) in enumerate(equations.items()):
        columns = [variables.index(a) for a in quantities_of(function)]
        if columns:
            least, most = proved(function, tuple(low[columns].tolist()), tuple(high[columns].tolist()), c, budget)
            if not np.all(np.isfinite(least) & np.isfinite(most)):
                steep = [variables[j] for j, a, b in zip(columns, least, most, strict=True) if not np.isfinite(b - a)]
                raise ValueError(
                    f"the equation of {name} has no bounded slope in {', '.join(steep)} over the envelope; "
                    "narrow the envelope to where the equation is defined"
                )
            against, central = 2 * np.maximum(np.minimum(-least, most), 0.0), np.maximum(-least, most)
            signs[e, columns] = np.where(against < central, np.sign(least + most), 0.0)
            unproved[e, columns] = np.minimum(against, central)
            size[e, columns] = central
    return Slopes(signs, unproved, size)


@lru_cache(maxsize=1024)
def _proved(
    function: Callable[..., Any], low: tuple[float, ...], high: tuple[float, ...], c: Any, budget: int
) -> tuple[Array, Array]:
    """The slopes of an equation with its parameters, computed once in a process."""
    return slopes(lambda *a: function(*a, c), np.array(low), np.array(high), budget)
