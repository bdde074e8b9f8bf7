"""Process hypotheses that have been accepted: how large they are now, and until when they stand.

An augmented state that has jumped or drifted is estimated from then on; it stands while its estimate differs from what it was
before by two standard deviations. It may change further: process noise of a share of its size is added. Its rivals, which
explained the readings nearly as well when it was accepted, are followed, too: one that turns out to have changed is accepted.
The error of a state equation is a rate that may go on: process noise of its size is added, which decays, and it stands until
little of it is left.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

DECAY = 0.97  # of the added process noise in a sample
LEAST = 0.1  # of it, with which the error of an equation still stands
DOUBT = 0.1  # share of the squared size that is added to its variance: the size may change further
WALK = 0.02  # change of an accepted augmented state in a sample, over its size
LONG_AGO = 1e6  # samples
RELEASE = 2.0  # standard deviations
CONFIRM = 4.0  # standard deviations by which a rival differs


class Standing(NamedTuple):
    """Of P process hypotheses, the first p of augmented states, the last n of equations.

    accepted (..., P): bool. rival (..., p): alternatives, bool. before (..., p): estimates of the augmented states before they
    changed. size, sd (..., n): of the errors of equations when they were accepted. left (..., n): share of the added process
    noise. since (...): samples since the last hypothesis was accepted.
    """

    accepted: Array
    rival: Array
    before: Array
    size: Array
    sd: Array
    left: Array
    since: Array


def nothing(batch: tuple[int, ...], added: int, states: int) -> Standing:
    """Return the state in which the model holds."""
    size, sd, left = (np.zeros((*batch, states)) for _ in range(3))
    accepted, before = np.zeros((*batch, added + states), bool), np.zeros((*batch, added))
    return Standing(accepted, np.zeros((*batch, added), bool), before, size, sd, left, np.full(batch, LONG_AGO))


def added_noise(now: Standing, rates: Array, z: Array) -> Array | None:
    """Process noise (..., n + p, n + p) by what stands; rates (n, n): effects of errors of equations on the states, as columns;
    z (..., p): augmented states.
    """
    if not now.accepted.any():
        return None
    n, p = now.left.shape[-1], z.shape[-1]
    noise = np.zeros((*z.shape[:-1], n + p, n + p))
    scaled = rates * (now.size * np.sqrt(now.left))[..., None, :]
    noise[..., :n, :n] = scaled @ np.swapaxes(scaled, -1, -2)
    np.einsum("...ii->...i", noise)[..., n:] = np.where(now.accepted[..., :p], (WALK * (z - now.before)) ** 2, 0.0)
    return noise


def with_accepted(now: Standing, which: Array, rivals: Array, z: Array, size: Array, sd: Array) -> Standing:
    """Add the hypotheses for which `which` (..., P) holds, and their rivals (..., P).

    z (..., p): augmented states so far. size, sd (..., P): of the hypotheses.
    """
    p = now.before.shape[-1]
    watched = now.accepted[..., :p] | now.rival
    fresh, rates = (which | rivals)[..., :p] & ~watched, which[..., p:]
    return Standing(
        now.accepted | which,
        now.rival | rivals[..., :p],
        np.where(fresh, z, now.before),
        np.where(rates, size[..., p:], now.size),
        np.where(rates, sd[..., p:], now.sd),
        np.where(rates, 1.0, now.left),
        np.where(np.any(which, axis=-1), 0.0, now.since),
    )


def followed(now: Standing, z: Array, variance: Array) -> Standing:
    """Release what no longer differs, accept rivals that do: augmented states z (..., p), their variances, after an update."""
    if not (now.accepted.any() or now.rival.any() or now.left.any()):
        return now._replace(since=now.since + 1)
    left = np.where(now.left * DECAY >= LEAST, now.left * DECAY, 0.0)
    p, by = z.shape[-1], np.abs(z - now.before) / np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    own = now.accepted[..., :p] & (by > RELEASE) | now.rival & (by > CONFIRM)
    accepted = np.concatenate([own, now.accepted[..., p:] & (left > 0)], axis=-1)
    rival = now.rival & np.any(accepted, axis=-1, keepdims=True)
    return now._replace(accepted=accepted, rival=rival, left=left, since=now.since + 1)


def sizes(now: Standing, above: Array, variance: Array) -> tuple[Array, Array]:
    """Size and standard deviation (..., P), NaN where not accepted; above: augmented states less their nominal values."""
    if not now.accepted.any():
        return np.full(now.accepted.shape, np.nan), np.full(now.accepted.shape, np.nan)
    size = np.concatenate([above, now.size], axis=-1)
    sd = np.concatenate([np.sqrt(variance), now.sd], axis=-1)
    return np.where(now.accepted, size, np.nan), np.where(now.accepted, sd, np.nan)
