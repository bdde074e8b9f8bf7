"""A second look at a log after its diagnosis: one Kalman filter without the readings that the detector isolated.

The detector decides sample by sample. Afterwards it is known which readings were faulty, and roughly since when; without these
the filter states what every sensor should have read and how well that is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.hindsight_parts import beginning
from fusion_sfdia.diagnosis.hindsight_steps import Hindsight, OneRun, Steps, begun, keep, seen_at, unknown
from fusion_sfdia.filters.estimators import GaussianState
from fusion_sfdia.plant.gaps import Track
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

LEAD = 15  # samples before an isolation that are left out, too: an alarm follows its fault


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

    A long log is cut into parts, which are filtered side by side as a batch, where the model is the same at all times: see
    `hindsight_parts`. One of a large linear plant is filtered with gains at rest.
    """
    count, n = out.shape
    found, start, steps, run = unknown(count, n), begun(model), Steps(track, out), OneRun(model)
    with np.errstate(all="ignore"):
        first, core = beginning(model, steps, found, each)
        for s in each(range(first, track.t.size)):
            if np.isfinite(track.begins[s]):
                core = start
            seen = run.seen_at(core, steps.before(s), float(track.t[s]), track.y[s], track.u[s], steps.use[s])
            if not seen.sound:
                for values, none in zip(found, (np.nan, np.nan, np.nan, np.nan, 0), strict=True):
                    values[steps.sample(s) :] = none
                break
            core = seen.core
            if track.own[s]:
                keep(found, steps.sample(s), seen)
    return found


def looked(
    model: Plant, core: GaussianState, times: tuple[float, float], values: tuple[Array, Array], use: Array
) -> tuple[GaussianState | None, Hindsight]:
    """One step of `hindsight` over `times` with readings y (N,), of which those to `use` (N,), and inputs u (m,): the filter
    after it, None where it has no finite value, and of this sample what is known.
    """
    (before, now), (y, u) = times, values
    with np.errstate(all="ignore"):
        seen = seen_at(model, core, before, now, now - before, y, u, use)
    return (seen.core, seen.row) if seen.sound else (None, Hindsight(*(v[0] for v in unknown(1, len(y)))))
