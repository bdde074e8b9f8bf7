"""The adaptive observer: its rate of convergence, and when it is inactive."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.detectors.adaptive_thresholds.adaptive_observer import Estimates, Rates, adapt, adaptive_rate


def test_the_adaptive_law_converges_with_its_rate() -> None:
    """With f~ = f - f^, the law's own transform x~ + Omega f~ decays at rate + gain: then f~ alone by 1 - dt times the rate."""
    rates = Rates(rate := 100.0, gain=445.0, learning=8.7)
    dt, x, f = 0.01, 3.95e5, 5e4
    now = Estimates(*(np.array([v]) for v in (x, 0.0, 0.0)))
    left = []
    for _ in range(400):
        reading = np.array([x + f])
        now = adapt(now, np.array([rate * x]), reading, reading, np.array([True]), dt, rates)
        left.append(float((f - now.fault)[0]))
    expected = adaptive_rate(rates)
    assert expected == pytest.approx(0.2929, abs=1e-4)  # V22: "within approximately 10 s"
    # e^(-5.45 k) of the start is left after k steps, nothing after twenty; readings of 4e5 are rounded to 6e-11, f~ is 2e4
    ratio = np.array(left[20:]) / np.array(left[19:-1])
    np.testing.assert_allclose(ratio, 1 - dt * expected, rtol=1e-12)
    # the printed gain of M(4,1): 1e5 s and more
    assert adaptive_rate(Rates(0.2, 319.98, 5.0)) == pytest.approx(1.95e-6, rel=1e-2)


def test_an_adaptive_observer_is_inactive_until_its_module_fires_and_without_readings() -> None:
    start = Estimates(np.array([1.0, 1.0]), np.zeros(2), np.zeros(2))
    reading, h = np.array([3.0, np.nan]), np.array([1.0, 1.0])
    after = adapt(start, h, reading, reading, np.array([False, True]), 0.1, Rates(1.0, 2.0, 1.0))
    assert after.fault.tolist() == [0.0, 0.0] and after.omega[1] == 0.0
    assert after.state[1] == pytest.approx(1.0, rel=1e-15) and after.state[0] > 1.0
