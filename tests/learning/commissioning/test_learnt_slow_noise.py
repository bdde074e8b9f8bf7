"""Slow noise of sensors is learnt from a healthy log where it is there, and only there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom
from toy_plants import chain

from fusion_sfdia.learning.commissioning.learnt_slow_noise import LEAST, slow_noise, with_slow_noise
from fusion_sfdia.plant.slow_noise import SlowNoise, inflation_of

DT = 10.0


def innovations(rng: np.random.Generator, steps: int, runs: int, share: float = 0.0, samples: float = 1.0) -> Any:
    """White noise of variance 4 (steps, runs) with a slow part."""
    q = np.exp(-1 / samples)
    drive = rng.standard_normal((steps, runs))
    drive[1:] *= np.sqrt(1 - q**2)
    wandering = lfilter([1.0], [1.0, -q], drive, axis=0)
    return 2 * (np.sqrt(1 - share) * rng.standard_normal((steps, runs)) + np.sqrt(share) * wandering)


@pytest.mark.parametrize("runs", [1, 4])
def test_white_noise_shows_none(runs: int) -> None:
    """The limit is that of chi-square for one log of a thousand; with a bounded share and time constant it is hardly more."""
    rng = np.random.default_rng(1)
    found = sum(slow_noise(innovations(rng, 400, runs), DT) is not None for _ in range(300))
    assert found <= binom.ppf(0.999, 300, 5e-3)


@pytest.mark.parametrize(("share", "samples"), [(0.5, 20.0), (0.3, 40.0), (0.8, 5.0)])
def test_sums_vary_as_much_as_those_of_the_slow_noise_that_is_found(share: float, samples: float) -> None:
    """Share and time constant go together; what counts is by how much sums over 30 and 120 samples vary."""
    rng, found = np.random.default_rng(2), []
    for _ in range(40):
        one = slow_noise(innovations(rng, 800, 4, share, samples), DT)
        assert one is not None
        found.append([inflation_of(n, one.share, np.exp(-DT / one.time_constant)) for n in (30, 120)])
    true = [inflation_of(n, share, np.exp(-1 / samples)) for n in (30, 120)]
    logs = np.log(np.array(found) / true)
    assert (np.abs(logs.mean(axis=0)) < 4 * logs.std(axis=0) / np.sqrt(40) + 0.1).all()


def test_a_log_that_is_short_or_has_gaps_is_taken_as_it_is() -> None:
    rng = np.random.default_rng(3)
    assert slow_noise(innovations(rng, LEAST - 1, 3, 0.5, 5.0), DT) is None
    single = innovations(rng, 800, 2, 0.5, 20.0)
    single[100:140, 0] = single[:, 1] = np.nan
    assert slow_noise(single, DT) is not None
    assert slow_noise(np.full((200, 2), np.nan), DT) is None


def test_a_sensor_that_shows_none_stays_as_it_is_stated() -> None:
    rng, plant = np.random.default_rng(4), chain(3)
    stated = SlowNoise(0.4, 7.0)
    plant = replace(plant, sensors=tuple(replace(s, noise=stated if s.name == "s1" else None) for s in plant.sensors))
    single = np.stack([innovations(rng, 800, 2, share, 20.0) for share in (0.5, 0.0, 0.0)], axis=-1)
    first, second, third = (s.noise for s in with_slow_noise(plant, single).sensors)
    assert first is not None and first != stated and (second, third) == (stated, None)
