"""Divergence: when an estimator has broken down, and how the other runs of its batch continue."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.alike import single
from fusion_sfdia.core.detector import Decision
from fusion_sfdia.core.equation import compiled, plain
from fusion_sfdia.core.state import mapped

Array = NDArray[Any]


def broken(x: Array, p: Array) -> Array:
    """Return (...) whether the estimate x (..., n) or covariance p (..., n, n) is no longer finite and non-negative."""
    n = x.shape[-1]
    found: Array = _broken(plain(x.reshape(-1, n)), plain(single(p).reshape(-1, n, n)))
    return found.reshape(x.shape[:-1])


@compiled
def _broken(x: Array, p: Array) -> Array:
    """The same of estimates (B, n); p (B, n, n) or (1, n, n)."""
    found, lost = np.empty(x.shape[0], np.bool_), np.empty(p.shape[0], np.bool_)
    for k in range(p.shape[0]):
        lost[k] = False
        for i in range(p.shape[1]):
            lost[k] |= not p[k, i, i] >= 0
            for j in range(p.shape[2]):
                lost[k] |= not np.isfinite(p[k, i, j])
    for r in range(x.shape[0]):
        found[r] = lost[r % p.shape[0]]
        for i in range(x.shape[1]):
            found[r] |= not np.isfinite(x[r, i])
    return found


def keep_broken_out(diverged: Array, memory: Any, fresh: Any) -> Any:
    """Return the memory with the diverged runs of the batch replaced by fresh ones: they are flagged, the others continue."""
    if not np.any(diverged):
        return memory

    def kept(a: Array, b: Array) -> Array:
        return np.where(diverged.reshape(diverged.shape + (1,) * (a.ndim - diverged.ndim)), b, a)

    return mapped(kept, memory, fresh)


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
