"""One compiled step of the diagnosers of all areas: estimates, thresholds, weights, memory and alarms.

The equations are those of consensus.predict and consensus.take. It runs on one processor core; the cost of an area does not
depend on the number of areas.
"""

from __future__ import annotations

from operator import is_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import plain
from fusion_sfdia.detectors.stochastic_thresholds import consensus_equations
from fusion_sfdia.detectors.stochastic_thresholds.consensus import NO_TERMS, Diagnosers, NetworkReadings, require_mode
from fusion_sfdia.detectors.stochastic_thresholds.consensus_equations import Terms
from fusion_sfdia.plant.areas import AreaArrays, Areas

Array = NDArray[Any]


def terms_of(areas: AreaArrays, mode: str = "corrected") -> Terms:
    """The terms of areas that miss no reading, which do not change from step to step; see `update_terms`."""
    count, n, _ = areas.matrices.shape
    terms = Terms(np.empty((count, 1 + 2 * n)), np.empty((int(areas.start[-1]), 2)))
    update_terms(terms, areas, np.arange(count), mode)
    return terms


def update_terms(terms: Terms, areas: AreaArrays, changed: Array, mode: str = "corrected") -> None:
    """Compute the terms of some areas (M,) anew, in place: after their arrays have been changed in place."""
    count, n, _ = areas.matrices.shape
    zero = np.broadcast_to(0.0, (1, count, n)), np.broadcast_to(0.0, (1, areas.slope.size))
    consensus_equations.write_terms(changed, Diagnosers(*zero, *zero, *zero, *zero), mode == "paper", areas, terms)


def network_step(
    areas: Areas, state: Diagnosers, given: NetworkReadings, alpha: float, lam: float, mode: str = "corrected",
    out: Diagnosers | None = None, terms: Terms = NO_TERMS,
) -> tuple[Diagnosers, Array]:  # fmt: skip
    """Return the diagnosers of B runs after the next readings, and which areas have a residual beyond alpha deviations (B, N).

    out: diagnosers to be overwritten, such as those before `state`; without them a large network spends its time on memory
    allocation. terms: `terms_of(areas.arrays, mode)`, which a step of a large network takes half of its time to compute. Raises
    ValueError for other shapes, an unknown mode, or an `out` that is the state itself.
    """
    require_mode(areas, mode)
    own, shared, reference, load = map(plain, given)
    if out is None:
        out = Diagnosers(*map(np.empty_like, state))
    alarm = np.zeros(reference.shape, bool)
    misread = len(own) != len(reference) or any(map(is_, state, out))  # without any readings the loop would only predict
    misread |= (state.covariance.shape[-1] > 0) != areas.partly_read
    if misread or not consensus_equations.step_areas(
        state, reference, load, lam, mode == "paper", areas.arrays, terms, alpha, own, shared, out, alarm
    ):
        raise _misfit(areas, state, given, out)
    return out, alarm


def _misfit(areas: Areas, state: Diagnosers, given: NetworkReadings, out: Diagnosers) -> ValueError:
    batch, (count, n, sides) = len(state.held), areas.size
    side = n if areas.partly_read else 0
    found = state.held.shape, state.held_shared.shape, state.covariance.shape, *(a.shape for a in given)
    of_areas, of_sides = (batch, count, n), (batch, sides)
    expected = of_areas, of_sides, (batch, count, side, side), of_areas, of_sides, (batch, count), (batch, count)
    if found != expected:
        return ValueError(
            f"held, held_shared, covariance, own, shared, reference, load have the shapes {found}; expected {expected}"
        )
    return ValueError(
        "out is the state itself or has other shapes; give an earlier result of this function that is not needed any more"
    )
