"""Performance indicators of distributed fault diagnosis (Kougiatsos 2024, sec. VI, (19)-(26)).

t (K,) s; decisions (K, B, M) bool of modules; active (K, B) or (K, B, N) bool, where faults act, permanent ones from their
onset on; isolated (K, B, N) bool. Time first, then runs. Intervals of 95 %: see metrics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs, proportion, require_shapes

Array = NDArray[Any]


class Response(NamedTuple):
    """Response of a group of modules to a fault: share of runs that miss it; delay (s) in the others; its range."""

    missed: Estimate
    delay: Estimate
    shortest: float
    longest: float


def smallest_detectable(residual: Array, lower: Array, upper: Array, gain: Array | float = 1.0) -> Array:
    """Return the smallest |fault| that takes a noise-free residual (K, ...) out of [lower, upper] at some time, by (19).

    gain (K, ...) is d residual / d fault, 1 for a sensor's own residual where the prediction does not use it; the result is inf
    where it is 0. With noise a smaller fault can be detected. Raises ValueError where the healthy residual is outside already.
    """
    if np.any((residual < lower) | (residual > upper)):
        raise ValueError(
            "the healthy noise-free residual leaves its thresholds: a false alarm has no smallest fault; widen them"
        )
    g = np.abs(np.broadcast_to(gain, np.shape(residual)))
    slack = np.minimum(residual - lower, upper - residual)
    return np.asarray(np.divide(slack, g, out=np.full(g.shape, np.inf), where=g > 0).min(axis=0))


def smallest_detected(sizes: Array, detected: Array) -> Estimate:
    """Return the mean over runs of the smallest of sizes (S,) that is detected in the run, detected (S, B): (19) as observed.

    Runs that detect none are left out: compare n with the number of runs. A size is rounded up to the next of the grid.
    """
    require_shapes(detected=(detected, (len(sizes), *np.shape(detected)[1:2])))
    magnitude = np.where(detected, np.abs(np.asarray(sizes, dtype=float))[:, None], np.inf).min(axis=0, initial=np.inf)
    some = np.isfinite(magnitude)
    return mean_over_runs(np.where(some, magnitude, 0.0), some)


def response(t: Array, decisions: Array, active: Array, modules: Sequence[int]) -> Response:
    """Return missed-detection rate and delay of a fault, active (K, B), by the first of the modules to fire while it acts.

    With the fault's own module it is (20) and (22), with the modules of the other agents (21): that the fault is missed
    as a propagated fault. A decision latched before the onset counts as detection without delay.
    """
    require_shapes(active=(active, decisions.shape[:2]), t=(t, decisions.shape[:1]))
    seen = decisions[..., list(modules)].any(axis=-1) & active
    faulty, caught = active.any(axis=0), seen.any(axis=0)
    delays = (t[np.argmax(seen, axis=0)] - t[np.argmax(active, axis=0)])[caught]
    return Response(
        proportion(int((faulty & ~caught).sum()), int(faulty.sum())),
        mean_over_runs(delays, np.ones(delays.size)),
        float(delays.min(initial=np.inf)) if delays.size else float("nan"),
        float(delays.max(initial=0.0)) if delays.size else float("nan"),
    )


def isolation_performance(t: Array, isolated: Array, active: Array, alarm: Array) -> Estimate:
    """Return P^U, (23) and (25), as a fraction: the time mean from the first alarm (K, B) on of |S^F and S_0| / |S^F|.

    1 - U/|S^F| = |S_0|/|S^F| as printed assumes that the faulty S_0 are isolated; one that is not isolated does not count here.
    Where no sensor is isolated the term, 0/0 as printed, is 0 while a fault is active and 1 while none is. Runs without an
    alarm before the last sample are left out. A sample holds until the next.
    """
    require_shapes(isolated=(isolated, active.shape))
    count, right = isolated.sum(axis=-1), (isolated & active).sum(axis=-1)
    share = np.where(count > 0, right / np.maximum(count, 1), ~active.any(axis=-1))
    return _from_first_alarm(t, share, alarm)


def exoneration_performance(t: Array, isolated: Array, alarm: Array) -> Estimate:
    """Return P^E, (24) and (26), as a fraction: the time mean from the first alarm on of the share of sensors not isolated.

    It does not show whether a faulty sensor is among them: read it together with isolation_metrics.isolation_recall.
    """
    return _from_first_alarm(t, 1 - isolated.mean(axis=-1), alarm)


def _from_first_alarm(t: Array, share: Array, alarm: Array) -> Estimate:
    require_shapes(alarm=(alarm, share.shape), t=(t, share.shape[:1]))
    begun = np.logical_or.accumulate(alarm, axis=0)[:-1]
    weight = begun * np.diff(t)[:, None]
    time = weight.sum(axis=0)
    judged = time > 0
    means = (share[:-1] * weight).sum(axis=0)[judged] / time[judged]
    return mean_over_runs(means, np.ones(means.size))
