"""Sentences about a scenario's numbers, filled from its rows, so that they state what the run shows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from fusion_sfdia.report.results import Row


def pick(rows: Iterable[Row], **expected: str | Sequence[str]) -> list[Row]:
    """Return the rows with a finite value whose columns (detector="...", fault=("...", "...")) are as expected."""
    allowed = {column: (value,) if isinstance(value, str) else tuple(value) for column, value in expected.items()}
    return [r for r in rows if math.isfinite(r.value) and all(getattr(r, c) in values for c, values in allowed.items())]


def span(values: Iterable[float]) -> str:
    """Return "0.67 to 0.99", one number where all agree to three digits, "unknown" where there is none."""
    found = sorted(v for v in values if math.isfinite(v))
    if not found:
        return "unknown"
    low, high = _short(found[0]), _short(found[-1])
    return low if low == high else f"{low} to {high}"


def listed(rows: Iterable[Row], column: str = "detector") -> str:
    """Return the span of the values for each entry of a column: "fusing-ekf 0.67 to 0.84; loo-glr 0.98", or "unknown"."""
    values: dict[str, list[float]] = {}
    for r in rows:
        values.setdefault(getattr(r, column), []).append(r.value)
    return "; ".join(f"{name} {span(found)}" for name, found in values.items()) or "unknown"


def left_out(rows: Iterable[Row]) -> list[str]:
    """Return a sentence on the runs that diverged, which no other number counts; none where there are none."""
    lost = [r for r in rows if r.metric.startswith("diverged") and r.value > 0]
    cases = [
        f"{r.detector} {r.value:.0%} ({r.quantity}, {r.fault}{', without diagnosis' * r.metric.endswith('unaccommodated')})"
        for r in lost
    ]
    rule = "Where the estimate diverged the run is left out, and a cell without runs has no value or bar"
    return [f"{rule}: {'; '.join(cases)} of the runs."] if cases else []


def _short(value: float) -> str:
    return f"{value:.0f}" if 1000 <= abs(value) < 1e7 else f"{value:.3g}"
