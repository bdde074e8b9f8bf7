"""Selection of residuals: those that are stable, and of these the simplest with the isolability of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.structural_residuals.sequences import Sequences
from fusion_sfdia.detectors.structural_residuals.structure import Residual, computable, modules_of
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

FORGETTING = 1 - 1e-9  # a step must shrink an error by more than rounding; an integrator keeps it


def usable(plant: Plant) -> tuple[Residual, ...]:
    """Return the computable residuals whose states forget their errors, the simplest first; raises as `structural_model`.

    Stability is that of a step of plant.dt at the nominal values. A target that is a state without it, as where a level
    integrates measured flows, gets the feedback of its observer. A residual that would integrate the noise of other
    sensors without bound is not used.
    """
    found = computable(plant)
    forget = _forget(plant, found)
    found = tuple(r if ok else replace(r, feedback=r.target in r.integrated) for r, ok in zip(found, forget, strict=True))
    return tuple(r for r, ok in zip(found, _forget(plant, found), strict=True) if ok)


def _forget(plant: Plant, residuals: tuple[Residual, ...]) -> Array:
    if not residuals:
        return np.zeros(0, bool)
    u = np.array([s.nominal for s in plant.inputs])
    return Sequences(modules_of(plant), residuals).forgetting(u, plant.dt) < FORGETTING


def reads(plant: Plant, residuals: Sequence[Residual]) -> Array:
    """Return the fault signature matrix (R, N): which residuals read which sensors."""
    found = [[s.measures in r.read for s in plant.sensors] for r in residuals]
    return np.array(found, bool).reshape(len(residuals), len(plant.sensors))


def isolable(signatures: Array) -> Array:
    """Return whether fault i is isolable from fault j (N, N): a residual (R, N) reads sensor i and not j. On the diagonal:
    whether fault i is detectable.
    """
    others = ~signatures[:, None, :] | np.eye(signatures.shape[1], dtype=bool)
    return np.asarray((signatures[:, :, None] & others).any(axis=0))


def selected(plant: Plant) -> tuple[Residual, ...]:
    """Return, for each pair of sensors, the simplest usable residual that reads the one and not the other; raises as `usable`.

    The simplest has the fewest sensors, then the first of the two as its target, then the fewest equations. Together they
    isolate what all usable ones do. Few sensors rather than few residuals, as a minimal hitting set would have
    (`TestSelection` of the toolbox): each sensor that is read adds its noise and hides part of the other sensors'
    faults. The fault of a target enters the residual in full, that of another sensor as far as the equations transmit it.
    """
    residuals = usable(plant)
    signatures = reads(plant, residuals)
    chosen = set()
    for i, sensor in enumerate(plant.sensors):
        simplest = sorted(
            np.flatnonzero(signatures[:, i]), key=lambda k: (len(residuals[k].read), residuals[k].target != sensor.measures)
        )
        for j in range(len(plant.sensors)):
            chosen.update([k for k in simplest if j == i or not signatures[k, j]][:1])
    return tuple(residuals[k] for k in sorted(chosen))
