"""Means of errors over the last rows, and what a single cause explains of them.

Over the last w rows: m, the mean of the errors; D, the mean of their derivatives with respect to the causes; phi, that of the
regressors. With S the covariance of m in healthy operation and g >= 1, by which it grows away from it,

    T = m' S^-1 m / g,    J_h = (D_h' S^-1 m)^2 / (g D_h' S^-1 D_h),    size_h = D_h' S^-1 m / D_h' S^-1 D_h

T is the generalised likelihood ratio of any change of the mean, J_h that of cause h alone: T - J_h is what h leaves. Beside a
cause that is known to act, with the derivatives d, both are of what is left of m and D once d is taken out: S^-1 becomes
S^-1 - S^-1 d d' S^-1 / d' S^-1 d.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.filters.gaussian import half_inverse

Array = NDArray[Any]

WINDOWS = (1, 3, 10, 60, 240)  # rows
KNOWN = 0.5  # least share of the rows of a window with a reading
TINY = np.finfo(float).tiny
DISTINCT = 1e-3  # share of D' S^-1 D that is left beside a cause that acts, below which a cause counts as the same


def enough(count: Array, share: Array, w: Array | int) -> Array:
    """Whether of w rows so many (..., N) have a reading, of a sensor that usually has one in that share of them (N,)."""
    return np.asarray(count >= np.maximum(KNOWN * share * w, 1.0))


def sums(ring: Array, count: Array, row: int) -> Array:
    """Sums (..., R, k) over the last rows of a ring (..., L, k), of rows numbered from 0 the latest `row`; count: `latest`."""
    length = ring.shape[-2]
    start = length - 1 - row % length
    return np.asarray(count[:, start : start + length] @ ring)


def latest(rows: Sequence[int], length: int) -> Array:
    """Which are the last so many rows (R,) of a ring (R, 2 length), where its latest is at the end of the first half."""
    age = np.tile(np.arange(length)[::-1], 2)
    return (age < np.reshape(rows, (-1, 1))).astype(float)


class Spread(NamedTuple):
    """The covariance S (..., N, N) of means, with U, S^-1 = U U'."""

    half: Array
    cov: Array


def explained(
    spread: Spread, m: Array, known: Array, by_cause: Array, g: Array, beside: Array | None = None
) -> tuple[Array, Array, Array, Array]:
    """T (...), J, size and D' S^-1 D (..., M) of means m (..., N), of readings known (..., N), with D (..., N, M); g (...).

    beside (..., N): d of a cause that acts, 0 in runs without one.
    """
    if known.all():
        half = spread.half
    else:
        half = half_inverse(np.broadcast_to(spread.cov, (*m.shape, m.shape[-1])), known)
    back = np.swapaxes(half, -1, -2)
    white = (back @ np.where(known, m, 0.0)[..., None])[..., 0]
    effect = back @ np.where(known[..., None], by_cause, 0.0)
    if beside is not None:
        acts = (back @ np.where(known, beside, 0.0)[..., None])[..., 0]
        acts = acts / np.sqrt(np.maximum(np.sum(acts**2, axis=-1, keepdims=True), TINY))
        white = white - acts * np.sum(acts * white, axis=-1, keepdims=True)
        left = effect - acts[..., None] * np.sum(acts[..., None] * effect, axis=-2, keepdims=True)
        effect = np.where(
            np.sum(left**2, axis=-2, keepdims=True) > DISTINCT * np.sum(effect**2, axis=-2, keepdims=True), left, 0.0
        )
    along = (np.swapaxes(effect, -1, -2) @ white[..., None])[..., 0]
    power = np.maximum(np.sum(effect**2, axis=-2), TINY)
    return np.sum(white**2, axis=-1) / g, along**2 / power / g[..., None], along / power, power
