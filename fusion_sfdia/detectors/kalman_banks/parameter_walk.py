"""How fast uncertain parameters move: learnt from corrections that go to one side.

With D the mean of the corrections K d of a parameter over about 1 / FADE samples, and G the variance that an update takes from
it, D^2 is about FADE / (2 - FADE) G where the parameter moves as stated. Where it is ONE_SIDED times that, the walk is taken as
faster.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

FADE = 1 / 32
ONE_SIDED = 4.0  # times what chance gives
UP, DOWN = 0.3, 0.06  # of the logarithm of the rate, in a sample
MOST = 2 * np.log(100.0)
UNIT = 1e-3  # of the prior standard deviation: the walk in a sample to which the logarithm refers


class Walk(NamedTuple):
    """Running mean of the corrections of the augmented states, and the logarithm of their walk's variance (..., p) each."""

    corrections: Array
    rate: Array


def no_walk(batch: tuple[int, ...], added: int) -> Walk:
    """No more than what the plant states."""
    return Walk(np.zeros((*batch, added)), np.zeros((*batch, added)))


def noise_of(now: Walk, sd: Array) -> Array | None:
    """Variance (..., p) that is added in a step; sd (p,): prior standard deviations. None where there is none."""
    return (np.exp(now.rate) - 1) * (UNIT * sd) ** 2 if now.rate.any() else None


def followed(now: Walk, correction: Array, gained: Array, where: Array) -> Walk:
    """With the corrections of an update and the variance that it took (..., p), in runs `where` (...) holds."""
    mean = now.corrections + FADE * (correction - now.corrections)
    chance = FADE / (2 - FADE) * gained
    with np.errstate(divide="ignore", invalid="ignore"):
        fast = (chance > 0) & (mean**2 > ONE_SIDED * chance)
    rate = np.clip(now.rate + np.where(fast, UP, -DOWN), 0.0, MOST)
    return Walk(np.where(where[..., None], mean, now.corrections), np.where(where[..., None], rate, now.rate))
