"""The diagnosers of all areas of a network, one step at a time (Boem et al. 2018, sec. III; see consensus_equations).

One loop computes all diagnosers, but each number of an area depends only on its own readings and on what its neighbours
send: the drive of a state that they share, and the brackets of (6) and (15).
"""

from __future__ import annotations

from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import plain
from fusion_sfdia.detectors.stochastic_thresholds import consensus_equations as equations
from fusion_sfdia.detectors.stochastic_thresholds.consensus_equations import UNKNOWN
from fusion_sfdia.plant.areas import Areas

Array = NDArray[Any]
MODES = ("corrected", "paper")
NO_COVARIANCE = np.empty((1, 0, 0))  # of areas that read all their states
NO_TERMS = equations.Terms(np.empty((0, 0)), np.empty((0, 0)))  # a step then computes them


class Diagnosers(NamedTuple):
    """The memory of the diagnosers: own states (B, N, n), and shared ones (B, 2E), of the copies at the sides.

    held: the last readings, or estimates where a reading was missing. error_bound: 0 for a reading; for an estimate a bound of
    the standard deviation of its error. residual: y - x_hat, 0 where a reading was missing. deviation: s, a bound of the
    standard deviation of the residual. covariance (B, N, n, n): Sigma of the errors of held values in areas with unread states,
    whose error bounds are 0; 0 in other areas, (B, N, 0, 0) in a network whose areas read all their states.
    """

    held: Array
    held_shared: Array
    error_bound: Array
    error_bound_shared: Array
    residual: Array
    residual_shared: Array
    deviation: Array
    deviation_shared: Array
    covariance: Array = NO_COVARIANCE

    @property
    def own(self) -> tuple[Array, Array, Array, Array]:
        return self.held, self.error_bound, self.residual, self.deviation

    @property
    def shared(self) -> tuple[Array, Array, Array, Array]:
        return self.held_shared, self.error_bound_shared, self.residual_shared, self.deviation_shared


class Prediction(NamedTuple):
    """For the next reading: estimate (6), deviation s of its residual (14, 15), error_bound of the estimate.

    Of areas with unread states: covariance (B, N, n, n), M of x - f(x_bar), and ahead (B, N, n), f(x_bar).
    """

    estimate: Array
    estimate_shared: Array
    deviation: Array
    deviation_shared: Array
    error_bound: Array
    error_bound_shared: Array
    covariance: Array = NO_COVARIANCE
    ahead: Array = NO_COVARIANCE


class NetworkReadings(NamedTuple):
    """Readings and inputs of a step: own (B, N, n) and shared (B, 2E) readings, NaN where missing; reference and load (B, N),
    which acted since the last readings. For a part of the network, those of its areas and sides.
    """

    own: Array
    shared: Array
    reference: Array
    load: Array


def initial_state(areas: Areas, batch: tuple[int, ...]) -> Diagnosers:
    """Return diagnosers without information for a batch of runs.

    Each copy starts from its first reading and is tested from the second on. States of an area with unread states start with
    FAR times the deviation that noise gives them in n steps: give `held` and `covariance` where they are known.
    """
    count, n, sides = areas.size
    own, shared = np.zeros((*batch, count, n)), np.zeros((*batch, sides))
    unknown = np.full_like(own, UNKNOWN), np.full_like(shared, UNKNOWN)
    covariance = np.zeros((*batch, count, 0, 0))
    if areas.partly_read:
        unknown[0][..., np.any(areas.unread, axis=1), :] = 0.0
        zero = np.zeros((1, count, n)), np.zeros((1, sides))
        now = Diagnosers(*zero, *zero, *zero, *zero, np.zeros((1, count, n, n)))
        for _ in range(n):
            now = after_readings(areas, now)
        variance = np.diagonal(now.covariance[0], axis1=-2, axis2=-1)
        variance = np.where(variance > 0, variance, np.max(variance, axis=-1, keepdims=True))
        covariance = np.zeros((*batch, count, n, n)) + equations.FAR**2 * variance[..., None] * np.eye(n)
    return Diagnosers(own, shared, *unknown, own.copy(), shared.copy(), own.copy(), shared.copy(), covariance)


def require_mode(areas: Areas, mode: str) -> None:
    """ValueError for an unknown mode, and for "paper" where a state is not read."""
    if mode not in MODES:
        raise ValueError(f"mode is {mode!r}; known: {', '.join(MODES)}")
    if mode == "paper" and areas.partly_read:
        raise ValueError(
            f"no sensor of its area reads {areas.unread_names}; the mode 'paper' has no equation for that: add them, "
            "or use the mode 'corrected'"
        )


def predict(areas: Areas, now: Diagnosers, reference: Array, load: Array, lam: float, mode: str) -> Prediction:
    """Return estimates and deviations for the next readings, under reference and load (B, N); batches are broadcast."""
    require_mode(areas, mode)
    count, n, sides = areas.size
    of_areas, of_sides, inputs = now.own, now.shared, (reference, load)
    batch = np.broadcast_shapes(*{a.shape[:-2] for a in of_areas}, *{a.shape[:-1] for a in (*of_sides, *inputs)})
    own = [_flat(a, batch, (count, n)) for a in of_areas]
    shared = [_flat(a, batch, (sides,)) for a in of_sides]
    covariance = _flat(now.covariance, batch, (count, n, n) if areas.partly_read else (count, 0, 0))
    known = Diagnosers._make([*(a for pair in zip(own, shared, strict=True) for a in pair), covariance])
    found = Diagnosers._make(map(np.empty_like, known))
    none = np.empty((0, count, n)), np.empty((0, sides))
    equations.step_areas(
        known, _flat(reference, batch, (count,)), _flat(load, batch, (count,)), lam, mode == "paper", areas.arrays, NO_TERMS,
        1.0, *none, found, np.empty((len(own[0]), count), bool),
    )  # fmt: skip
    after = Diagnosers._make(a.reshape(*batch, *a.shape[1:]) for a in found)
    return Prediction(
        after.held, after.held_shared, after.deviation, after.deviation_shared, after.error_bound, after.error_bound_shared,
        after.covariance, after.residual,
    )  # fmt: skip


def take(areas: Areas, predicted: Prediction, own: Array, shared: Array) -> Diagnosers:
    """Return the diagnosers after the readings own (B, N, n) and shared (B, 2E); NaN where missing, left out or unread."""
    kept = []
    own_and_shared = (
        (own, predicted.estimate, predicted.deviation, predicted.error_bound),
        (shared, predicted.estimate_shared, predicted.deviation_shared, predicted.error_bound_shared),
    )
    for y, estimate, deviation, error_bound in own_and_shared:
        held, bound, s = (
            np.array(a if a.shape == y.shape else np.broadcast_to(a, y.shape), order="C")
            for a in (estimate, error_bound, deviation)
        )
        residual = np.empty(y.shape)
        equations.take_readings(np.ravel(y), held.reshape(-1), bound.reshape(-1), residual.reshape(-1), s.reshape(-1))
        kept.append((held, bound, residual, s))
    batch = own.shape[:-2]
    covariance = np.array(np.broadcast_to(predicted.covariance, (*batch, *predicted.covariance.shape[-3:])), order="C")
    after = Diagnosers._make([*(x for pair in zip(*kept, strict=True) for x in pair), covariance])
    if areas.partly_read:
        flat, shape = Diagnosers._make(x.reshape(prod(batch), *x.shape[len(batch) :]) for x in after), own.shape[-2:]
        given = _flat(own, batch, shape), _flat(predicted.ahead, batch, shape).copy()
        equations.take_unread(areas.arrays, *given, flat)
    return after


def after_readings(areas: Areas, now: Diagnosers) -> Diagnosers:
    """Return the diagnosers (1, ...) after a reading of 0 of each sensor: their covariance does not depend on values."""
    still = np.zeros((1, areas.size[0]))
    own, shared = np.where(areas.unread, np.nan, 0.0)[None], np.where(areas.received, np.nan, 0.0)[None]
    return take(areas, predict(areas, now, still, still, 0.0, "corrected"), own, shared)


def _flat(a: Array, batch: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    """The array (*batch, *shape) with the leading axes of the batch merged into one, of one type for compiled code."""
    whole = a if a.shape == (*batch, *shape) else np.broadcast_to(a, (*batch, *shape))
    return plain(whole).reshape(prod(batch), *shape)
