"""A second look at a log after its diagnosis: one Kalman filter without the readings that the detector isolated.

The detector decides sample by sample. Afterwards it is known which readings were faulty, and roughly since when; without these
the filter states what every sensor should have read and how well that is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.gaps import Track
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.filters.gaussian import condition

Array = NDArray[Any]

LEAD = 15  # samples before an isolation that are left out, too: an alarm follows its fault


class Hindsight(NamedTuple):
    """Of each sample and sensor (K, N): error, the reading less its estimate from the other sensors, sd of that without a
    fault, and normal, the innovation over its standard deviation where the reading is used. nis (K,): normalised innovation
    squared per reading used, and used (K,), their number. NaN where nothing is known.
    """

    error: Array
    sd: Array
    normal: Array
    nis: Array
    used: Array


def left_out(isolated: Array, lead: int = LEAD) -> Array:
    """Which readings (K, N) are left out: those that are isolated, and `lead` samples before each."""
    found = isolated.copy()
    for shift in range(1, min(lead, len(isolated) - 1) + 1):
        found[:-shift] |= isolated[shift:]
    return found


def hindsight(model: Plant, track: Track, out: Array, each: Callable[[Sequence[int]], Iterable[int]] = iter) -> Hindsight:
    """Run the extended Kalman filter of a plant over a log without the readings `out` (K, N).

    Of a reading that is used, the error is the leave-one-out residual u_i / w_i with u = S^-1 d and w = diag S^-1, whose
    variance is 1 / w_i; of one that is not, y - h(x) after the others were used, with the variance R + H P H'. Where the
    filter has no finite value any more, everything after is NaN.
    """
    count, n = out.shape
    found = unknown(count, n)
    core, before, k = begun(model), np.nan, -1
    for s in each(range(track.t.size)):
        if np.isfinite(track.begins[s]):
            core, before = begun(model), float(track.begins[s])
        own, now = bool(track.own[s]), float(track.t[s])
        k += own
        use = np.isfinite(track.y[s]) & ~out[k] if own else np.zeros(n, bool)
        after, row = looked(model, core, (before, now), (track.y[s], track.u[s]), use)
        if after is None:
            break
        if own:
            for values, value in zip(found, row, strict=True):
                values[k] = value
        core, before = after, now
    return found


def unknown(count: int, n: int) -> Hindsight:
    """Of `count` samples of n sensors nothing is known."""
    error, sd, normal = (np.full((count, n), np.nan) for _ in range(3))
    return Hindsight(error, sd, normal, np.full(count, np.nan), np.zeros(count, int))


def begun(model: Plant) -> GaussianState:
    """The filter at its start."""
    found: GaussianState = Extended().start(model, (), step_stream(0, 0))
    return found


def looked(
    model: Plant, core: GaussianState, times: tuple[float, float], values: tuple[Array, Array], use: Array
) -> tuple[GaussianState | None, Hindsight]:
    """One step of `hindsight` over `times` with readings y (N,), of which those to `use` (N,), and inputs u (m,): the filter
    after it, None where it has no finite value, and of this sample what is known.
    """
    filter_, rng, cov = Extended(), step_stream(0, 0), model.sensor_cov  # this filter draws nothing
    (before, now), (y, u) = times, values
    with np.errstate(all="ignore"):
        prior = filter_.predict(model, core, before, u, now - before, rng)
        joint = filter_.joint(model, prior, now, u)
        after = condition(joint, y, use)
        if np.any(prior.lost) or not (np.all(np.isfinite(after.x)) and np.all(np.isfinite(after.P))):
            nothing = unknown(1, len(y))
            return None, Hindsight(*(v[0] for v in nothing))
        w = np.where(use, np.diagonal(after.inverse), np.nan)
        h = model.output_jacobian_at(now, after.x, u)
        d = np.where(use, after.innovation, 0.0)
        error = np.where(use, after.inverse @ d / w, y - model.output(now, after.x, u))
        sd = np.sqrt(np.where(use, 1 / w, np.sum((h @ after.P) * h, axis=-1) + cov))
        normal = np.where(use, d / np.sqrt(np.diagonal(joint.S)), np.nan)
    return GaussianState(after.x, after.P), Hindsight(error, sd, normal, after.nis, np.sum(use))
