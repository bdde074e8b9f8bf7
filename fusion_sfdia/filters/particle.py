"""Particle filters: the bootstrap filter and the Gaussian particle filter, for noise or models far from Gaussian and linear.

As in `enkf`, one generator serves a whole batch, and the numbers drawn do not depend on which readings are missing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.filters.gaussian import sample, square_root, whiten

Array = NDArray[Any]
Model = Callable[[Array], Array]


class Particles(NamedTuple):
    """Weighted points: members (..., M, n) and the logarithms of their weights (..., M), which sum to 1.

    Weights that have no finite sum (every member left the domain of the model) are NaN.
    """

    members: Array
    log_weights: Array

    @property
    def weights(self) -> Array:
        return np.exp(self.log_weights)

    @property
    def effective_size(self) -> Array:
        """Effective sample size 1 / sum w^2 (...), a number of equal weights with that accuracy (Kong, Liu and Wong 1994)."""
        return np.asarray(1.0 / np.sum(self.weights**2, axis=-1))

    @property
    def moments(self) -> tuple[Array, Array]:
        """Mean (..., n) and covariance (..., n, n)."""
        return weighted_moments(self.members, self.weights)


def weighted_moments(members: Array, weights: Array) -> tuple[Array, Array]:
    """Mean (..., n) and covariance (..., n, n) of members (..., M, n) with weights (..., M).

    Members of weight 0 do not count, not even infinite ones.
    """
    w = weights[..., None]
    members = np.where(w == 0, 0.0, members)
    x = np.sum(w * members, axis=-2)
    spread = np.sqrt(w) * (members - x[..., None, :])
    return x, np.swapaxes(spread, -1, -2) @ spread


def start(x: Array, P: Array, size: int, rng: np.random.Generator, batch: tuple[int, ...] = ()) -> Particles:
    """Return particles (*batch, size, n) of equal weight, drawn from N(x, P); x (n,), P (n,) or (n, n)."""
    if size < 2:
        raise ValueError(f"{size} particles; a covariance needs at least 2, and a filter some hundreds")
    return Particles(x + sample(P, rng, (*batch, size)), np.full((*batch, size), -np.log(size)))


def predict(particles: Particles, f: Model, Q: Array, rng: np.random.Generator) -> Particles:
    """Return the particles after a step: f(X) + w, w from N(0, Q), Q (n,) or (n, n); f maps (..., M, n) to the same."""
    return particles._replace(members=f(particles.members) + sample(Q, rng, particles.members.shape[:-1]))


def update(
    particles: Particles, h: Model, y: Array, R: Array, rng: np.random.Generator, threshold: float = 0.5
) -> tuple[Particles, Array]:
    """Weigh the particles by the readings y (..., N), NaN where missing, and resample where the effective size is small.

    R is (N,) or (N, N). Returns the particles and the effective size before resampling (...); see `weigh` and `resample`.
    """
    weighed = weigh(particles, h(particles.members), y, R)
    return resample(weighed, rng, threshold), weighed.effective_size


def weigh(particles: Particles, predicted: Array, y: Array, R: Array) -> Particles:
    """Return the particles weighed by the readings y (..., N), NaN where missing, that they predict as (..., M, N).

    log w <- log w - (y - h(X))' R^-1 (y - h(X)) / 2 + constant    (Gordon, Salmond and Smith 1993)
    """
    return particles._replace(log_weights=normalise(particles.log_weights + log_likelihood(predicted, y, R)))


def resample(weighed: Particles, rng: np.random.Generator, threshold: float = 0.5) -> Particles:
    """Return the particles resampled where their effective size is below threshold times their number.

    Numbers are drawn whether used or not, so that the stream does not depend on the data.
    """
    size = weighed.log_weights.shape[-1]
    effective = weighed.effective_size
    offset = rng.random(effective.shape)
    poor = effective < threshold * size
    if not np.any(poor):
        return weighed
    index = np.where(poor[..., None], systematic(weighed.weights, offset), np.arange(size))
    members = np.take_along_axis(weighed.members, index[..., None], axis=-2)
    return Particles(members, np.where(poor[..., None], -np.log(size), weighed.log_weights))


def log_likelihood(predicted: Array, y: Array, R: Array) -> Array:
    """Return -(y - h)' R^-1 (y - h) / 2 over the readings that are not NaN (..., M), for predictions (..., M, N)."""
    used = np.isfinite(y)
    difference = whiten(np.where(used, y, 0.0)[..., None, :] - predicted, R, used)
    squared = np.sum(difference * difference, axis=-1)
    return np.where(np.isfinite(squared), -0.5 * squared, -np.inf)


def normalise(log_weights: Array) -> Array:
    """Return log weights (..., M) less log(sum(exp)), so that the weights sum to 1; NaN where nothing finite is left."""
    largest = np.max(log_weights, axis=-1, keepdims=True)
    shifted = log_weights - np.where(np.isfinite(largest), largest, np.nan)
    return np.asarray(shifted - np.log(np.sum(np.exp(shifted), axis=-1, keepdims=True)))


def systematic(weights: Array, offset: Array) -> Array:
    """Indices (..., M) of a systematic resample of weights (..., M) that sum to 1, offset (...) in [0, 1) (Kitagawa 1996).

    Member i is taken once for each of the positions (j + offset) / M, j = 0 ... M - 1, that its share of the cumulated weight
    contains: M w_i times, rounded up or down.
    """
    size = weights.shape[-1]
    cumulated = np.cumsum(np.nan_to_num(weights, nan=1.0 / size), axis=-1)
    reached = np.clip(np.floor(size * cumulated - offset[..., None]) + 1, 0, size).astype(int)
    reached[..., -1] = size
    counts = np.diff(reached, axis=-1, prepend=0)
    members = np.broadcast_to(np.arange(size), weights.shape)
    return np.repeat(members.ravel(), counts.ravel()).reshape(weights.shape)


def gaussian_predict(x: Array, P: Array, f: Model, Q: Array, size: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return x (..., n), P (..., n, n) after a step, from `size` draws of N(x, P) (Kotecha and Djuric 2003)."""
    members = f(_draws(x, P, size, rng))
    return weighted_moments(members + sample(Q, rng, members.shape[:-1]), np.full(members.shape[:-1], 1.0 / size))


def gaussian_update(
    x: Array, P: Array, h: Model, y: Array, R: Array, size: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return x (..., n), P (..., n, n) after the readings y (..., N), NaN where missing, and the effective size (...).

    `size` draws of N(x, P) are weighed by their likelihood (Kotecha and Djuric 2003). Without a reading x, P stay the same.
    """
    members = _draws(x, P, size, rng)
    weighed = Particles(members, normalise(log_likelihood(h(members), y, R)))
    new_x, new_P = weighed.moments
    read = np.any(np.isfinite(y), axis=-1)[..., None]
    return np.where(read, new_x, x), np.where(read[..., None], new_P, P), weighed.effective_size


def _draws(x: Array, P: Array, size: int, rng: np.random.Generator) -> Array:
    z = rng.standard_normal((*x.shape[:-1], size, x.shape[-1]))
    return np.asarray(x[..., None, :] + z @ np.swapaxes(square_root(P), -1, -2))
