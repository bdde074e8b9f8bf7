"""A whole step of the diagnosers of all areas, compiled: estimates, thresholds, weights, what is kept, and alarms.

The equations are those of consensus.predict and consensus.take. One core; every area costs the same whatever their number.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.areas import Areas
from fusion_sfdia.stochastic_thresholds import consensus_equations
from fusion_sfdia.stochastic_thresholds.consensus import MODES, Diagnosers

Array = NDArray[Any]


def network_step(
    areas: Areas, state: Diagnosers, own: Array, shared: Array, reference: Array, load: Array,
    alpha: float, lam: float, mode: str = "corrected", out: Diagnosers | None = None,
) -> tuple[Diagnosers, Array]:  # fmt: skip
    """The diagnosers of B runs after the next readings, and (B, N) which areas have a residual beyond alpha deviations.

    own (B, N, n), shared (B, 2E): readings, NaN where missing. reference, load (B, N): what acted since the last ones.
    out: diagnosers to be overwritten, such as those before `state`; without them a large network waits for fresh memory.
    ValueError for other shapes, an unknown mode, or an `out` that is the state itself.
    """
    at, (count, n, sides) = areas.network.topology, areas.size
    batch = len(state.held)
    if mode not in MODES:
        raise ValueError(f"mode is {mode!r}; known: {', '.join(MODES)}")
    given = state.held.shape, state.held_shared.shape, own.shape, shared.shape, reference.shape, load.shape
    expected = (batch, count, n), (batch, sides), (batch, count, n), (batch, sides), (batch, count), (batch, count)
    if given != expected:
        raise ValueError(f"what is held, own, shared, reference, load have the shapes {given}; expected {expected}")
    if out is None:
        out = Diagnosers(*(np.empty(a.shape) for a in state))
    elif any(new is a or new.shape != a.shape for new, a in zip(out, state, strict=True)):
        raise ValueError("out is the state or not like it; give what this function returned before and is needed no more")
    consensus_equations.step_areas(
        *state, _plain(reference), _plain(load), lam, mode == "paper", areas.matrices, areas.slope, areas.network.closed,
        areas.process_variance, areas.noise, areas.shared_noise, at.start, areas.opposite, _plain(own), _plain(shared), *out,
    )  # fmt: skip
    alarm = consensus_equations.find_alarms(
        out.residual, out.residual_shared, out.deviation, out.deviation_shared, alpha, at.start
    )
    return out, alarm


def _plain(a: Array) -> Array:
    return np.ascontiguousarray(a, dtype=float)
