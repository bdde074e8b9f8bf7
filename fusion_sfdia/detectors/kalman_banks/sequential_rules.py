"""Sequential tests of standardised residuals z, white N(0, 1) when healthy, as recursions.

    Shewhart       |z|                                             (Shewhart 1931: no memory)
    SumOfSquares   sqrt(sum of the last L z^2)                     chi with L degrees of freedom
    Cusum          g+ <- max(0, g+ + z - k), g- <- max(0, g- - z - k), the larger       (Page 1954)
    Ewma           e <- (1 - lam) e + lam z, over its own standard deviation            (Roberts 1959)

The memory of a batch is an array (..., rows, N) with one column for each sensor. A missing z (NaN) does not change the column.
`share` is the false-alarm probability of one sensor in a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

from fusion_sfdia.common.arguments import number, whole

Array = NDArray[Any]

OVERSHOOT = 1.166  # 2 * .583: mean excess of a Gaussian random walk over both limits of a CUSUM (Siegmund 1985)
LEAST = 0.1  # smallest limit of a CUSUM


class SequentialRule(Protocol):
    """A sequential test: its initial memory, the memory after z (..., N), the statistic and its limit (..., N)."""

    def start(self, batch: tuple[int, ...], sensors: int) -> Array: ...
    def advance(self, memory: Array, z: Array) -> Array: ...
    def statistic(self, memory: Array) -> Array: ...
    def limit(self, memory: Array, share: float) -> Array: ...


@dataclass(frozen=True)
class Shewhart:
    """The present sample alone; its limit is a Gaussian quantile.

    Examples
    --------
    >>> from fusion_sfdia.detectors import Shewhart
    >>> rule = Shewhart()
    >>> round(float(rule.limit(rule.start((), 4), 0.0027)[0]), 2)  # three standard deviations
    3.0
    """

    def start(self, batch: tuple[int, ...], sensors: int) -> Array:
        return np.zeros((*batch, 1, sensors))

    def advance(self, memory: Array, z: Array) -> Array:
        return _where_seen(z, z[..., None, :], memory)

    def statistic(self, memory: Array) -> Array:
        return np.abs(memory[..., 0, :])

    def limit(self, memory: Array, share: float) -> Array:
        return np.full(memory.shape[:-2] + memory.shape[-1:], -ndtri(share / 2))


@dataclass(frozen=True)
class SumOfSquares:
    """The last `length` samples, with the chi-square quantile of the number of samples so far: exact for white z.

    Parameters
    ----------
    length : int, default 15
        Samples.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.detectors import SumOfSquares
    >>> rule = SumOfSquares(length=10)
    >>> memory = rule.start((), sensors=1)
    >>> for z in (0.5, 2.0, 1.5):
    ...     memory = rule.advance(memory, np.array([z]))
    >>> rule.statistic(memory).round(2), rule.limit(memory, share=1e-3).round(2)
    (array([2.55]), array([4.03]))
    """

    length: int = 15

    def __post_init__(self) -> None:
        whole("length, in samples,", self.length, least=1)

    def start(self, batch: tuple[int, ...], sensors: int) -> Array:
        return np.full((*batch, self.length, sensors), np.nan)

    def advance(self, memory: Array, z: Array) -> Array:
        return _where_seen(z, np.concatenate([(z**2)[..., None, :], memory[..., :-1, :]], axis=-2), memory)

    def statistic(self, memory: Array) -> Array:
        return np.asarray(np.sqrt(np.sum(np.where(np.isfinite(memory), memory, 0.0), axis=-2)))

    def limit(self, memory: Array, share: float) -> Array:
        quantiles = np.sqrt(chdtri(np.arange(1, self.length + 1), share))
        return np.asarray(quantiles[np.maximum(np.sum(np.isfinite(memory), axis=-2), 1) - 1])


@dataclass(frozen=True)
class Cusum:
    """Two-sided cumulative sum for a shift of the mean by `shift` standard deviations, for which k = shift / 2 is optimal.

    Parameters
    ----------
    shift : float, default 1
        In standard deviations of z.

    Notes
    -----
    The limit h gives each sum a mean time between false alarms of 2 / share, by Siegmund's (1985) approximation of its run
    length, (exp(2 k b) - 2 k b - 1) / (2 k^2) with b = h + 1.166. It is accurate to some per cent for white z, and not a bound.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.detectors import Cusum
    >>> rule = Cusum(shift=0.5)
    >>> memory = rule.start((), sensors=1)
    >>> for z in (0.5, 2.0, 1.5):
    ...     memory = rule.advance(memory, np.array([z]))
    >>> rule.statistic(memory).round(2), rule.limit(memory, share=1e-3).round(2)
    (array([3.25]), array([9.93]))
    """

    shift: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < number("shift", self.shift) < np.inf:
            raise ValueError(f"shift is {self.shift} standard deviations; expected a positive number, such as 1")

    def start(self, batch: tuple[int, ...], sensors: int) -> Array:
        return np.zeros((*batch, 2, sensors))

    def advance(self, memory: Array, z: Array) -> Array:
        rise = np.stack([z, -z], axis=-2) - self.shift / 2
        return _where_seen(z, np.maximum(memory + rise, 0.0), memory)

    def statistic(self, memory: Array) -> Array:
        return np.asarray(np.max(memory, axis=-2))

    def limit(self, memory: Array, share: float) -> Array:
        return np.full(memory.shape[:-2] + memory.shape[-1:], cusum_limit(self.shift / 2, share))


@dataclass(frozen=True)
class Ewma:
    """Exponentially weighted moving average with the weight of Lucas and Saccucci (1990) for shifts of about one sigma.

    Parameters
    ----------
    lam : float, default 0.2
        Weight of the present sample.

    Notes
    -----
    Its variance grows with its samples, v <- (1 - lam)^2 v + lam^2; the limit is a Gaussian quantile, exact for white z.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.detectors import Ewma
    >>> rule = Ewma(lam=0.1)
    >>> memory = rule.start((), sensors=1)
    >>> for z in (0.5, 2.0, 1.5):
    ...     memory = rule.advance(memory, np.array([z]))
    >>> rule.statistic(memory).round(2), rule.limit(memory, share=1e-3).round(2)
    (array([2.36]), array([3.29]))
    """

    lam: float = 0.2

    def __post_init__(self) -> None:
        if not 0 < number("lam", self.lam) <= 1:
            raise ValueError(f"lam is {self.lam}; expected a weight above 0 and at most 1, such as 0.2")

    def start(self, batch: tuple[int, ...], sensors: int) -> Array:
        return np.zeros((*batch, 2, sensors))

    def advance(self, memory: Array, z: Array) -> Array:
        average, variance = memory[..., 0, :], memory[..., 1, :]
        kept = 1 - self.lam
        return _where_seen(z, np.stack([kept * average + self.lam * z, kept**2 * variance + self.lam**2], axis=-2), memory)

    def statistic(self, memory: Array) -> Array:
        variance = memory[..., 1, :]
        return np.abs(memory[..., 0, :]) / np.sqrt(np.where(variance > 0, variance, 1.0))

    def limit(self, memory: Array, share: float) -> Array:
        return np.full(memory.shape[:-2] + memory.shape[-1:], -ndtri(share / 2))


@cache
def cusum_limit(k: float, share: float) -> float:
    """The limit h of both sums, see `Cusum`; at least LEAST, below which the approximation has no meaning."""
    from scipy.optimize import brentq

    grown = 4 * k**2 / share  # value of exp(s) - s - 1, s = 2 k b
    s = float(brentq(lambda s: np.expm1(s) - s - grown, 0.0, 2 * np.log1p(grown) + 1))
    return max(s / (2 * k) - OVERSHOOT, LEAST)


def _where_seen(z: Array, new: Array, old: Array) -> Array:
    return np.where(np.isfinite(z)[..., None, :], new, old)
