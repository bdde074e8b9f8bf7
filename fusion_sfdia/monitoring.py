"""One step of the observers and algebraic residuals of a plant's modules, with bounds, on arrays.

A plant may bring the same compiled (`Modules.monitor`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.equation import argument_names

Array = NDArray[Any]
Triple = tuple[Array, Array, Array]

ROUNDING = 1e-12  # relative, by which bounds are widened: some thousand times what a hundred operations round


class Settings(NamedTuple):
    """Of the E variables, the S states first, and the V - E inputs: nominal values, half-widths of the envelope, noise bounds
    (E,), rates and gains (S,), and the signs and slacks of the equations' corners (E, V), see corner_bounds.
    """

    nominal: Array
    half_width: Array
    bound: Array
    rates: Array
    gains: Array
    signs: Array
    unproved: Array
    rounding: float = ROUNDING


def monitor(
    equations: Mapping[str, Callable[..., Any]],
    variables: Sequence[str],
    c: Any,
    x: Array,
    error: Array,
    before: Array,
    reading: Array,
    u: Array,
    dt: float,
    s: Settings,
) -> tuple[Array, Array, Array, Array]:
    """Return estimates of the states and bounds of their errors (B, S) after a step, and bounds of the others (B, E - S).

    x, error (B, S) before the step; the readings before and after it (B, E), NaN where missing; u (B, V - E) during it. The
    equations are of variables in the order of `variables`, which then has the inputs; c: their parameters.
    """
    functions = list(equations.items())
    low, high = np.minimum(before, reading), np.maximum(before, reading)
    middle, radius = _box((low + high) / 2, (high - low) / 2, u, s)
    ahead, bound = np.empty_like(x), np.empty_like(x)
    for e in range(len(s.rates)):
        own = x[:, e], np.abs(middle[:, e] - x[:, e]) + radius[:, e]
        least, h, most = _bounds(*functions[e], e, variables, c, middle, radius, own, s)
        known = np.isfinite(before[:, e])
        gain = np.where(known, s.gains[e], 0.0)
        a = s.rates[e] + gain
        lam = np.exp(-a * dt)
        ahead[:, e] = lam * x[:, e] + (1 - lam) / a * (h + gain * np.where(known, before[:, e], 0.0))
        bound[:, e] = lam * error[:, e] + (1 - lam) / a * (np.maximum(most - h, h - least) + gain * s.bound[e])
    middle, radius = _box(reading, np.zeros_like(reading), u, s)
    found = [
        _bounds(*functions[e], e, variables, c, middle, radius, (middle[:, e], radius[:, e]), s)
        for e in range(len(s.rates), len(functions))
    ]
    shape = len(x), len(found)
    return ahead, bound, np.array([f[0] for f in found]).T.reshape(shape), np.array([f[2] for f in found]).T.reshape(shape)


def _box(middle: Array, radius: Array, u: Array, s: Settings) -> tuple[Array, Array]:
    """Middle and radius (B, V) of the truth; the envelope where a reading is missing; inputs as known."""
    missing = np.isnan(middle)
    middle = np.where(missing, s.nominal, middle)
    radius = np.where(missing, s.half_width, radius + s.bound)
    return np.concatenate([middle, u], axis=-1), np.concatenate([radius, np.zeros_like(u)], axis=-1)


def _bounds(
    name: str,
    function: Callable[..., Any],
    e: int,
    variables: Sequence[str],
    c: Any,
    middle: Array,
    radius: Array,
    own: tuple[Array, Array],
    s: Settings,
) -> Triple:
    """Lower bound, value in the middle and upper bound (B,) of an equation; own: middle and radius of its own variable."""
    columns = [variables.index(a) for a in argument_names(function) if a != "c"]

    def at(side: float) -> Array:
        values = [
            own[0] + side * s.signs[e, e] * own[1] if j == e else middle[:, j] + side * s.signs[e, j] * radius[:, j]
            for j in columns
        ]
        return np.broadcast_to(function(*values, c), middle.shape[:1])

    lower, value, upper = at(-1.0), at(0.0), at(1.0)
    slack = radius @ s.unproved[e] + s.unproved[e, e] * (own[1] - radius[:, e])
    slack += s.rounding * np.maximum(np.maximum(np.abs(lower), np.abs(value)), np.abs(upper))
    return np.minimum(lower, value) - slack, value, np.maximum(upper, value) + slack
