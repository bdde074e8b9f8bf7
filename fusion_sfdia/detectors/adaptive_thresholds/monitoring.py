"""One step of the observers and algebraic residuals of a plant's modules, with bounds, in array code.

The error of an observer, e = x^ - x, over a step whose correction L (y - x^) uses the reading y at the beginning of the step:

    e+ = lam e + int_0^dt exp(-a (dt - s)) [h^ - h(s) + L (y - x(0)) - L (x(s) - x(0))] ds.

The last term is the change of the state within the step, at most min(drift, s sup|h - rate x(0)|).
A plant may provide a compiled form of this step (`Modules.monitor`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import argument_names, compiled
from fusion_sfdia.plant.modules import Modules

Array = NDArray[Any]

ROUNDING = 1e-12  # relative widening of bounds: some thousand times the rounding of a hundred operations


class Settings(NamedTuple):
    """Constants of E variables, the S states first, and V - E inputs.

    nominal, half_width: middle and half-width of the envelope (E,). bound: noise bounds (E,). rates, gains: (S,), 1/s. signs,
    unproved: signs and slacks of the equations' corners (E, V), see corner_bounds. drift: largest drift of each state per
    second (S,), 0 at a steady load. Bound and gains may differ between runs (B, ...).
    """

    nominal: Array
    half_width: Array
    bound: Array
    rates: Array
    gains: Array
    signs: Array
    unproved: Array
    drift: Array | float = 0.0
    rounding: float = ROUNDING


@lru_cache(maxsize=1024)  # asked in each step
def quantities_of(equation: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of the variables and inputs that an equation takes: its arguments without its parameters c."""
    return tuple(a for a in argument_names(equation) if a != "c")


def monitor(
    m: Modules, x: Array, error: Array, before: Array, reading: Array, u: Array, dt: float, s: Settings
) -> tuple[Array, Array, Array, Array]:
    """Return estimates of the states and bounds of their errors (B, S) after a step, and bounds of the others (B, E - S).

    m: the modules, whose equations take variables, then inputs, in their order. x, error (B, S): before the step. before,
    reading (B, E): readings before and after the step, NaN where missing. u (B, V - E): during the step. Where an equation has
    no value at the readings, they are moved into the envelope.
    """
    variables, c = m.variables, m.parameters
    functions = [(f, [variables.index(a) for a in quantities_of(f)]) for f in m.equations.values()]
    states = len(s.rates)
    drift = np.broadcast_to(s.drift, states)
    low, high = box(np.minimum(before, reading), np.maximum(before, reading), u, s)
    ahead, bound = np.empty_like(x), np.empty_like(x)

    def bounds(e: int, low: Array, high: Array, at: Array | float = 0.0) -> tuple[Array, Array, Array]:
        function, columns = functions[e]
        lower, upper = _corners(function, columns, e, low, high, c, s)
        lost = ~np.isfinite(lower + at + upper)
        if np.any(lost):
            inside = _corners(function, columns, e, *into_envelope(low, high, s), c, s)
            lower, upper = np.where(lost, inside[0], lower), np.where(lost, inside[1], upper)
        return lower, np.where(lost, (lower + upper) / 2, at), upper

    for e in range(states):
        own_low, own_high, middle = low.copy(), high.copy(), (low + high) / 2
        own_low[:, e], own_high[:, e], middle[:, e] = np.minimum(low[:, e], x[:, e]), np.maximum(high[:, e], x[:, e]), x[:, e]
        function, columns = functions[e]
        least, h, most = bounds(e, own_low, own_high, _value(function, middle[:, columns], c))
        known, rate = np.isfinite(before[:, e]), s.rates[e]
        gain = np.where(known, s.gains[..., e], 0.0)
        a = rate + gain
        lam = np.exp(-a * dt)
        some = np.where(a > 0, a, 1.0)
        held = np.where(a > 0, (1 - lam) / some, dt)
        ahead[:, e] = lam * x[:, e] + held * (h + gain * np.where(known, before[:, e], 0.0))
        speed = np.maximum(np.abs(most - rate * x[:, e]), np.abs(least - rate * x[:, e])) + rate * error[:, e]
        moved = np.minimum(gain * held * drift[e] * dt, gain * (dt - held) / some * speed)
        grown = lam * error[:, e] + held * (np.maximum(most - h, h - least) + gain * s.bound[..., e]) + moved
        bound[:, e] = np.minimum(grown, np.abs(ahead[:, e] - s.nominal[e]) + s.half_width[e])
    low, high = box(reading, reading, u, s)
    found = [bounds(e, low, high) for e in range(states, len(functions))]
    lower, upper = np.empty((2, len(x), len(found)))
    for k, (least, _, most) in enumerate(found):
        lower[:, k], upper[:, k] = least, most
    return ahead, bound, lower, upper


def box(low: Array, high: Array, u: Array, s: Settings) -> tuple[Array, Array]:
    """Return the ends (B, V) of the box of true values from least and largest reading; the envelope where one is missing."""
    missing = np.isnan(low) | np.isnan(high)
    low, high = (
        np.where(missing, s.nominal - s.half_width, low - s.bound),
        np.where(missing, s.nominal + s.half_width, high + s.bound),
    )
    return np.concatenate([low, u], axis=1), np.concatenate([high, u], axis=1)


def into_envelope(low: Array, high: Array, s: Settings) -> tuple[Array, Array]:
    """Return the ends (B, V) of boxes moved into the envelope, in which equations have values."""
    free = np.full(low.shape[1] - len(s.nominal), np.inf)
    least, most = np.append(s.nominal - s.half_width, -free), np.append(s.nominal + s.half_width, free)
    return np.clip(low, least, most), np.clip(high, least, most)


def _value(function: Callable[..., Any], at: Array, c: Any) -> Array:
    value = np.asarray(function(*at.T, c))
    return value if value.shape == at.shape[:1] else np.broadcast_to(value, at.shape[:1])  # an equation of inputs alone


def _corners(
    function: Callable[..., Any], columns: list[int], e: int, low: Array, high: Array, c: Any, s: Settings
) -> tuple[Array, Array]:
    """Lower and upper bound (B,) of an equation over boxes (B, V)."""
    low, high, sign = low[:, columns], high[:, columns], s.signs[e, columns]
    middle = (low + high) / 2
    lower = _value(function, np.where(sign > 0, low, np.where(sign < 0, high, middle)), c)
    upper = _value(function, np.where(sign > 0, high, np.where(sign < 0, low, middle)), c)
    slack = (high - low) / 2 @ s.unproved[e, columns] + s.rounding * np.maximum(np.abs(lower), np.abs(upper))
    return lower - slack, upper + slack


@compiled
def decide(
    y: Array,
    x: Array,
    state_bound: Array,
    lower: Array,
    upper: Array,
    extra: Array,
    variable: Array,
    scale: Array,
    fired: Array,
    factor: float,
) -> Any:
    """Return residual, threshold, reconstruction, whether each module fires or has fired (B, N), and whether a prediction of
    the run is not finite (B,).

    y: readings (B, N) in sensor units. x, state_bound (B, S), lower, upper (B, E - S): the predictions in SI.
    extra (E,): added to the radius of a prediction. variable (N,): of each sensor.
    scale (N,): sensor units of one SI unit. fired (B, N): before this step. factor: multiplies the threshold.
    """
    size, count = y.shape
    states = x.shape[1]
    residual, threshold, reconstruction = np.empty((size, count)), np.empty((size, count)), np.empty((size, count))
    firing, lost = np.empty((size, count), np.bool_), np.zeros(size, np.bool_)
    for b in range(size):
        for i in range(count):
            e = variable[i]
            if e < states:
                predicted, radius = x[b, e], state_bound[b, e]
            else:
                predicted = (lower[b, e - states] + upper[b, e - states]) / 2
                radius = (upper[b, e - states] - lower[b, e - states]) / 2
            residual[b, i] = (y[b, i] / scale[i] - predicted) * scale[i]
            threshold[b, i] = factor * (radius + extra[e]) * abs(scale[i])
            reconstruction[b, i] = predicted * scale[i] if np.isnan(y[b, i]) else y[b, i]
            firing[b, i] = fired[b, i] or abs(residual[b, i]) > threshold[b, i]
            lost[b] = lost[b] or not np.isfinite(predicted)
    return residual, threshold, reconstruction, firing, lost
