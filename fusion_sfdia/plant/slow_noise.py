"""Slow noise of a sensor, and by how much sums over it vary more than sums of white noise.

A sum over n samples of noise with the correlation q from each sample to the next varies

    c(n, q) = 1 + 2 sum_{k=1}^{n-1} (1 - k/n) q^k = (1 + q) / (1 - q) - 2 q (1 - q^n) / (n (1 - q)^2)

times as much as one of white noise of the same variance, and 1 + s (c(n, q) - 1) times where only the share s of the variance
is correlated and the rest is white.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_sfdia.common.arguments import number


@dataclass(frozen=True)
class SlowNoise:
    """The slow part of a sensor's noise: first-order noise, as of a wandering zero point.

    Parameters
    ----------
    share : float
        Of the variance, from 0 to below 1; what is left is white.
    time_constant : float
        In s; its autocorrelation after t seconds is exp(-t / time_constant).

    Raises
    ------
    ValueError
        For others.

    Examples
    --------
    >>> from fusion_sfdia import Sensor
    >>> from fusion_sfdia.plants import SlowNoise
    >>> Sensor("gauge", "level", "m", sigma=0.01, noise=SlowNoise(share=0.5, time_constant=3000.0)).noise.share
    0.5
    """

    share: float
    time_constant: float

    def __post_init__(self) -> None:
        if not 0 <= number("slow noise: share", self.share) < 1:
            raise ValueError(f"slow noise: share is {self.share}; it must be at least 0 and below 1, a share of the variance")
        if not 0 < number("slow noise: time_constant", self.time_constant) < np.inf:
            raise ValueError(f"slow noise: time_constant is {self.time_constant}; it must be positive and finite, in seconds")


def inflation(n: Any, q: Any) -> Any:
    """c(n, q) of sums over n samples, of numbers or arrays; n may be inf."""
    return (1 + q) / (1 - q) - 2 * q * (1 - q**n) / (n * ((1 - q) * (1 - q)))


def inflation_of(n: Any, share: Any, q: Any) -> Any:
    """The same of noise of which that share is correlated, as of `Plant.slow_noise`."""
    return 1 + share * (inflation(n, q) - 1)
