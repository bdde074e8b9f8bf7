"""Divergence: when an estimator has broken down, and how the other runs of its batch continue."""

from __future__ import annotations

from dataclasses import fields, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import single
from fusion_sfdia.derivatives.equation import plain, python_first
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.state import mapped

Array = NDArray[Any]


def broken(x: Array, p: Array) -> Array:
    """Return (...) whether the estimate x (..., n) or covariance p (..., n, n) is no longer finite and non-negative."""
    n = x.shape[-1]
    found: Array = _broken(plain(x.reshape(-1, n)), plain(single(p).reshape(-1, n, n)))
    return found.reshape(x.shape[:-1])


@python_first
def _broken(x: Array, p: Array) -> Array:
    """The same of estimates (B, n); p (B, n, n) or (1, n, n)."""
    found, lost = np.empty(x.shape[0], np.bool_), np.empty(p.shape[0], np.bool_)
    for k in range(p.shape[0]):
        lost[k] = False
        for i in range(p.shape[1]):
            lost[k] |= not p[k, i, i] >= 0
            for j in range(p.shape[2]):
                lost[k] |= not isfinite(p[k, i, j])
    for r in range(x.shape[0]):
        found[r] = lost[r % p.shape[0]]
        for i in range(x.shape[1]):
            found[r] |= not isfinite(x[r, i])
    return found


def keep_broken_out(diverged: Array, memory: Any, fresh: Any) -> Any:
    """Return the memory with the diverged runs of the batch replaced by fresh ones: they are flagged, the others continue."""
    if not np.any(diverged):
        return memory

    return of_runs(diverged, fresh, memory)


def of_runs(where: Array, one: Any, other: Any) -> Any:
    """Of two tuples of arrays (*batch, ..), those of `one` in the runs `where` (*batch) holds, else those of `other`."""
    if where.all():
        return one
    if not where.any():
        return other

    def chosen(a: Array, b: Array) -> Array:
        return a if a is b else np.where(where.reshape(where.shape + (1,) * (a.ndim - where.ndim)), a, b)

    return mapped(chosen, one, other)


def decision_of_runs(where: Array, one: Decision, other: Decision) -> Decision:
    """Of two decisions that of `one` in the runs `where` (*batch) holds, else that of `other`; None where either has None."""

    def chosen(a: Array, b: Array) -> Array:
        a, b = (np.broadcast_to(v, where.shape) if v.ndim == 0 else v for v in (a, b))
        return np.where(where.reshape(where.shape + (1,) * (a.ndim - where.ndim)), a, b)

    named = {f.name: (getattr(one, f.name), getattr(other, f.name)) for f in fields(one)}
    found: dict[str, Any] = {name: None if a is None or b is None else chosen(a, b) for name, (a, b) in named.items()}
    return replace(other, **found)


def without_readings(held: Array, decision: Decision, expected: Decision) -> Decision:
    """Of the runs `held` (*batch) the decision `expected`, which was made without the readings, with their residuals,
    thresholds and nis; of the others `decision`.
    """
    kept = {name: getattr(decision, name) for name in ("residual", "threshold", "nis")}
    return replace(decision_of_runs(held, expected, decision), **kept)


NUMBERS = (
    "estimate", "reconstruction", "residual", "threshold", "fault_size", "process_size", "process_sd", "probability",
)  # fmt: skip
VERDICTS = ("isolated", "process", "suspect")


def without_broken(decision: Decision, diverged: Array) -> Decision:
    """Return the decision flagged as diverged where the filter has (...): there every number is NaN and nothing is isolated,
    accepted or suspected.
    """
    if not np.any(diverged):
        return replace(decision, diverged=diverged)
    gone = diverged[..., None]
    given = {name: a for name in (*NUMBERS, *VERDICTS) if (a := getattr(decision, name)) is not None}
    found: dict[str, Any] = {name: a & ~gone if name in VERDICTS else np.where(gone, np.nan, a) for name, a in given.items()}
    return replace(
        decision,
        **found,
        nis=np.where(diverged, np.nan, decision.nis),
        diverged=diverged,
        capped=decision.capped & ~diverged,
        covariance=None if decision.covariance is None else np.where(gone[..., None], np.nan, decision.covariance),
    )
