"""Sums of slow noise, and what slow noise is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rounding import rounding
from scipy.linalg import toeplitz

from fusion_sfdia.plant.signals import Sensor
from fusion_sfdia.plant.slow_noise import SlowNoise, inflation, inflation_of

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize("q", [0.0, 0.3, 0.9, 0.98])
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_sums_vary_as_the_correlations_of_their_samples_say(q: float, share: float) -> None:
    n = np.array([1, 2, 7, 40])
    correlations = [(1 - share) * np.eye(k) + share * toeplitz(q ** np.arange(k)) for k in n]
    expected = [c.sum() / k for c, k in zip(correlations, n, strict=True)]
    np.testing.assert_allclose(inflation_of(n, share, q), expected, rtol=rounding(2 / (1 - q) ** 2, 40))


def test_many_samples_of_slow_noise_vary_by_its_time_constant() -> None:
    assert inflation(np.inf, 0.9) == pytest.approx(1.9 / 0.1)
    assert inflation(1e6, 0.9) == pytest.approx(19, rel=1e-5)


@pytest.mark.parametrize(
    ("share", "time_constant", "message"),
    [
        (1.0, 60.0, "share is 1.0; it must be at least 0 and below 1, a share of the variance"),
        (-0.1, 60.0, "share is -0.1"),
        (NAN, 60.0, "share is nan"),
        ("half", 60.0, "share is 'half'"),
        (0.5, 0.0, "time_constant is 0.0; it must be positive and finite, in seconds"),
        (0.5, INF, "time_constant is inf"),
    ],
)
def test_slow_noise_has_a_share_and_a_time_constant(share: Any, time_constant: float, message: str) -> None:
    with pytest.raises(ValueError, match=f"slow noise: {message}"):
        SlowNoise(share, time_constant)


def test_noise_that_is_no_slow_noise_is_refused() -> None:
    with pytest.raises(ValueError, match=r"sensor 's': noise is 0\.5; expected SlowNoise\(share=\.\., time_constant=\.\.\)"):
        Sensor("s", "x", sigma=1.0, noise=0.5)  # type: ignore[arg-type]
