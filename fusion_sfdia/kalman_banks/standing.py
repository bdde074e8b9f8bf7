"""Process hypotheses that have been accepted: how large they are now, and until when they stand.

An augmented state that has jumped or drifted is estimated from then on; it stands while its estimate differs from what it was
before by two standard deviations. The error of a state equation is a rate that may go on: process noise of its size is added,
which decays, and it stands until little of it is left.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

DECAY = 0.97  # of the added process noise in a sample
LEAST = 0.1  # of it, with which the error of an equation still stands
DOUBT = 0.1  # share of the squared size that is added to its variance: the size may change further
RELEASE = 2.0  # standard deviations


class Standing(NamedTuple):
    """Of P process hypotheses, the first p of augmented states, the last n of equations.

    accepted (..., P): bool. before (..., p): estimates of the augmented states before they changed. size, sd (..., n): of the
    errors of equations when they were accepted. left (..., n): share of the added process noise.
    """

    accepted: Array
    before: Array
    size: Array
    sd: Array
    left: Array


def nothing(batch: tuple[int, ...], added: int, states: int) -> Standing:
    """Return the state in which the model holds."""
    rest = [np.zeros((*batch, states)) for _ in range(3)]
    return Standing(np.zeros((*batch, added + states), bool), np.zeros((*batch, added)), *rest)


def added_noise(now: Standing, rates: Array) -> Array | None:
    """Process noise (..., n, n) by the errors of equations, with their effects on the states as columns of rates (n, n)."""
    if not np.any(now.left):
        return None
    scaled = rates * (now.size * np.sqrt(now.left))[..., None, :]
    return np.asarray(scaled @ np.swapaxes(scaled, -1, -2))


def with_accepted(now: Standing, which: Array, z: Array, size: Array, sd: Array) -> Standing:
    """Add the hypotheses for which `which` (..., P) holds: augmented states z (..., p) so far, size and sd (..., P)."""
    p = now.before.shape[-1]
    fresh, rates = which & ~now.accepted, which[..., p:]
    return Standing(
        now.accepted | which,
        np.where(fresh[..., :p], z, now.before),
        np.where(rates, size[..., p:], now.size),
        np.where(rates, sd[..., p:], now.sd),
        np.where(rates, 1.0, now.left),
    )


def followed(now: Standing, z: Array, variance: Array) -> Standing:
    """Release what no longer differs: augmented states z (..., p) with their variances, after an update."""
    p = now.before.shape[-1]
    left = np.where(now.left * DECAY >= LEAST, now.left * DECAY, 0.0)
    differs = np.abs(z - now.before) > RELEASE * np.sqrt(variance)
    stands = np.concatenate([differs, left > 0], axis=-1) & now.accepted
    return now._replace(accepted=stands, left=left)


def sizes(now: Standing, above: Array, variance: Array) -> tuple[Array, Array]:
    """Size and standard deviation (..., P), NaN where not accepted; above: augmented states less their nominal values."""
    size = np.concatenate([above, now.size], axis=-1)
    sd = np.concatenate([np.sqrt(variance), now.sd], axis=-1)
    return np.where(now.accepted, size, np.nan), np.where(now.accepted, sd, np.nan)
