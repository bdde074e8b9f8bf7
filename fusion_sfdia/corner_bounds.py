"""Bounds of explicit equations over boxes from two corners, proved beforehand over an envelope and fast afterwards.

Over the envelope, a box that holds what healthy operation can read, interval derivatives prove the sign of each partial
derivative of each equation, or else bound its size. Inside it an equation f lies between its corners

    f(m_i - s_i r_i) - sum_j G_j r_j   and   f(m_i + s_i r_i) + sum_j G_j r_j

for the box of middle m and radius r, where s_i = +-1 is the sign of the slope and G_i = 0. If the sign is not proved,
l <= df/dx_i <= h with l < 0 < h, then either s_i is the sign of the larger and G_i twice the smaller of -l and h, by which
f may fall short of its end; or s_i = 0 and G_i is the larger. The mean value theorem in one variable after the other proves
both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.equation import argument_names
from fusion_sfdia.expression import record
from fusion_sfdia.interval import Interval
from fusion_sfdia.monotone import derivative, gradient

Array = NDArray[Any]
Equations = Mapping[str, Callable[..., Any]]

TRIED = 64  # boxes on which the side to halve is chosen
BOXES = 4096  # into which an envelope is cut at most to prove the signs of one equation


def slopes(function: Callable[..., Any], low: Array, high: Array, budget: int = BOXES) -> tuple[Array, Array]:
    """Return guaranteed lower and upper bounds (n,) of the partial derivatives of a function of n scalars over a box.

    For each argument in turn, boxes where the sign is open are halved, along the side that narrows its bounds the most, until
    it is proved, both signs are seen, or `budget` boxes are spent.
    """
    expression = record(function, n := len(low))

    def bounds(lo: Array, hi: Array, argument: int) -> tuple[Array, Array]:
        values = expression.evaluate([Interval(lo[:, i], hi[:, i]) for i in range(n)])
        # each keeps what the other loses: backward multiplies by the outer slopes first, forward by the inner ones
        found = gradient(expression, values)[argument].intersection(derivative(expression, values, argument))
        return np.broadcast_to(found.lo, len(lo)), np.broadcast_to(found.hi, len(lo))

    found = [_slope(lambda lo, hi, k=k: bounds(lo, hi, k), low, high, budget) for k in range(n)]  # type: ignore[misc]
    return np.array([f[0] for f in found]), np.array([f[1] for f in found])


def _slope(bounds: Callable[[Array, Array], tuple[Array, Array]], low: Array, high: Array, budget: int) -> tuple[float, float]:
    least, most = np.inf, -np.inf  # over the boxes that are done with
    falls = rises = False  # somewhere
    lo, hi, spent = low[None], high[None], 0
    while True:
        below, above = bounds(lo, hi)
        spent += len(lo)
        falls, rises = falls or bool(np.any(above < 0)), rises or bool(np.any(below > 0))
        is_open = (below < 0) & (above > 0)
        if (falls and rises) or not np.any(is_open) or spent + 2 * int(is_open.sum()) > budget:
            return min(least, float(below.min())), max(most, float(above.max()))
        if not np.all(is_open):
            least, most = min(least, float(below[~is_open].min())), max(most, float(above[~is_open].max()))
        lo, hi = lo[is_open], hi[is_open]
        some = slice(None, None, max(1, len(lo) // TRIED))
        parts = [_halved(lo[some], hi[some], side) for side in range(lo.shape[1])]
        tried = bounds(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]))
        left = np.maximum(np.minimum(tried[1], -tried[0]), 0.0).reshape(len(parts), -1)
        lo, hi = _halved(lo, hi, int(np.argmin(left.sum(axis=1))))


def _halved(lo: Array, hi: Array, side: int) -> tuple[Array, Array]:
    """Halve each box (M, n) along a side."""
    left, right = hi.copy(), lo.copy()
    left[:, side] = right[:, side] = (lo[:, side] + hi[:, side]) / 2
    return np.concatenate([lo, right]), np.concatenate([left, hi])


@dataclass(frozen=True)
class Slopes:
    """Of equations by variables (E, V): the signs s, -1, 0 or 1, and the slack G where they are not proved.

    size (E, V): the largest |derivative| of all, a Lipschitz constant by channel; 0 where an equation does not have a variable.
    """

    signs: Array
    unproved: Array
    size: Array


def prove(equations: Equations, variables: Sequence[str], low: Array, high: Array, c: Any, budget: int = BOXES) -> Slopes:
    """Prove the slopes of equations of the named variables over the envelope low..high (V,); c: their parameters.

    Raises ValueError for an envelope that is no box.
    """
    if not np.all((low < high) & np.isfinite(low) & np.isfinite(high)):
        wrong = [v for v, a, b in zip(variables, low, high, strict=True) if not (np.isfinite(a) and np.isfinite(b) and a < b)]
        raise ValueError(f"the envelope of {', '.join(wrong)} is no finite range; wanted low < high")
    shape = len(equations), len(variables)
    signs, unproved, size = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for e, function in enumerate(equations.values()):
        columns = [variables.index(name) for name in argument_names(function) if name != "c"]
        if columns:
            least, most = slopes(lambda *a, f=function: f(*a, c), low[columns], high[columns], budget)
            against, central = 2 * np.maximum(np.minimum(-least, most), 0.0), np.maximum(-least, most)
            signs[e, columns] = np.where(against < central, np.sign(least + most), 0.0)
            unproved[e, columns] = np.minimum(against, central)
            size[e, columns] = central
    return Slopes(signs, unproved, size)
