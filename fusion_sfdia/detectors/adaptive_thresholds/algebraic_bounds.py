"""Bounds of algebraic variables by interval methods, alternatives to the corners of `monitoring`.

- "inclusion": the equation in interval arithmetic over the box that the readings allow (Kougiatsos 2022, (36)). It is wider
  where an argument occurs several times.
- "sivia": all z with 0 in z - phi(z, box) by set inversion from an initial box (Kougiatsos 2024, (11)). Only z is bisected, but
  contraction with a narrow z removes part of the overestimation of inclusion. Array code, far slower.
- "codac": set inversion by codac, an optional dependency, one run at a time, still slower.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.intervals.codac_adapter import codac_sivia
from fusion_sfdia.derivatives.intervals.expression import Expression, record
from fusion_sfdia.derivatives.intervals.interval import Interval, select
from fusion_sfdia.derivatives.intervals.sivia import sivia
from fusion_sfdia.detectors.adaptive_thresholds.monitoring import Settings, box, into_envelope, quantities_of
from fusion_sfdia.plant.modules import Modules

Array = NDArray[Any]

METHODS = ("corners", "inclusion", "sivia", "codac")
INITIAL = 5.0  # the initial box of a variable is its nominal value divided and multiplied by this; chosen here, not published
TOLERANCE = 0.01  # of set inversion, in noise bounds; chosen here, not published


def enclosed(method: str, m: Modules, reading: Array, u: Array, s: Settings) -> tuple[Array, Array]:
    """Return lower and upper bounds (B, E - S) of the algebraic variables.

    reading (B, E): NaN where missing. u: inputs (B, V - E). Where an equation has no value, such as a root of negative
    readings, the readings are moved into the envelope.
    """
    ends = box(reading, reading, u, s)
    columns = []
    for variable in tuple(m.equations)[len(m.states) :]:
        found = enclosure(method, m, variable, *ends, s)
        if np.any(lost := ~np.isfinite(found.lo + found.hi)):
            found = select(lost, enclosure(method, m, variable, *into_envelope(*ends, s), s), found)
        columns.append(found)
    both = Interval.stack(columns)
    slack = s.rounding * np.maximum(np.abs(both.lo), np.abs(both.hi))
    return both.lo - slack, both.hi + slack


def enclosure(method: str, m: Modules, variable: str, low: Array, high: Array, s: Settings) -> Interval:
    """Enclosure (B,) of a variable over boxes low..high (B, V)."""
    names = quantities_of(m.equations[variable])
    over = {v: Interval(low[:, j], high[:, j]) for j, v in enumerate(m.variables)}
    value = _recorded(m, variable, False)
    found = value.evaluate([over[a] for a in names])[value.outputs[0]]
    if method != "inclusion":
        nominal, bound = m.nominal[variable], s.bound[m.variables.index(variable)]
        start = Interval(*sorted((nominal / INITIAL, nominal * INITIAL)))
        others = [over[a] for a in names if a != variable]
        invert = codac_hulls if method == "codac" else _hulls
        hull = invert(_recorded(m, variable, True), Interval.stack([start]), TOLERANCE * bound, others)
        found = select(hull.is_empty, found, hull)
    shape = low.shape[:1]
    return Interval.unchecked(np.broadcast_to(found.lo, shape), np.broadcast_to(found.hi, shape))


def _hulls(residual: Expression, start: Interval, tolerance: float, given: list[Interval]) -> Interval:
    """Where the residual can be 0 (B,), from the boxes of its first argument (1,) and of the others (B,)."""
    return sivia(residual, Interval(0.0), start, tolerance, parameters=given).hull[..., 0]


def codac_hulls(residual: Expression, start: Interval, tolerance: float, given: list[Interval]) -> Interval:
    """As `_hulls` by codac, one problem after the other."""
    runs = range(max((g.lo.size for g in given), default=1))
    at = [[g if g.shape == () else g[b] for g in given] for b in runs]
    return Interval.stack([codac_sivia(residual, Interval(0.0), start, tolerance, parameters=g).hull[0] for g in at])


@lru_cache(maxsize=256)
def _recorded(m: Modules, variable: str, implicit: bool) -> Expression:
    """The equation phi of its arguments; implicit: z - phi of z and the other arguments."""
    function = m.equations[variable]
    names = quantities_of(function)
    others = [a for a in names if a != variable]

    def residual(z: Any, *given: Any) -> Any:
        known = dict(zip(others, given, strict=True)) | {variable: z}
        return z - function(*(known[a] for a in names), m.parameters)

    return record(residual, 1 + len(others)) if implicit else record(lambda *a: function(*a, m.parameters), len(names))
