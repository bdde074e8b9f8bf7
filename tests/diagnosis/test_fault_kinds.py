"""Kinds and sizes of faults from residuals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from fusion_sfdia.diagnosis.fault_kinds import Named, NoiseOf, name, resized

RNG = np.random.default_rng(0)
RISING = np.minimum(np.arange(1, 51) / 30, 1.0)
SHAPES = {
    "bias": np.full(50, 8.0),
    "drift": 10 * RISING,
    "noise": 9 * np.random.default_rng(7).standard_normal(50),
    "spikes": np.where(np.arange(50) % 7 == 0, 9.0, 0.0) * np.where(np.arange(50) % 2, 1, -1),
}


def named(shape: Any, *, rng: np.random.Generator = RNG, sigma: float = 2.0, common: float = 1.0, **settings: Any) -> Named:
    """The name of residuals of a shape (n,) in units of sigma = 2, plus noise and an error of the estimate with sd 1."""
    n = len(shape)
    error = sigma * np.asarray(shape) + sigma * rng.standard_normal(n) + common * rng.standard_normal()
    sd = np.full(n, np.hypot(sigma, common))
    return name(error, sd, NoiseOf(sigma), settings.pop("y", error), **({"still": False, "over": True} | settings))


@pytest.mark.parametrize("kind", SHAPES)
def test_each_kind_has_its_name(kind: str) -> None:
    """Of 50 samples of 8 to 10 sigma at least 58 of 60 are named rightly, and the others not excluded where they are."""
    found = [named(SHAPES[kind], rng=np.random.default_rng(seed)) for seed in range(60)]
    assert sum(f.kind == kind for f in found) >= 58
    assert all(kind in (f.kind, *f.alternatives) for f in found)


@pytest.mark.parametrize(("kind", "size"), [("bias", 16.0), ("drift", 20.0)])
def test_intervals_hold_the_size(kind: str, size: float) -> None:
    """At least 95 % of 200, but for a chance of 3e-5: the bound on the common error makes them wide, not narrow."""
    found = [named(SHAPES[kind], rng=np.random.default_rng(seed)) for seed in range(200)]
    inside = sum(f.low <= size <= f.high for f in found if f.kind == kind)
    count = sum(f.kind == kind for f in found)
    assert inside >= binom.ppf(3e-5, count, 0.95)
    # of a bias no narrower than its known error: 1.96 sqrt(sigma^2 / n + common^2)
    half = 1.96 * np.sqrt(4 / 50 + 1.0)
    assert kind == "drift" or all(f.high - f.low >= 2 * half * 0.999 for f in found)


def test_noise_is_stated_without_what_a_healthy_sensor_has() -> None:
    found = [named(9 * np.random.default_rng(1000 + s).standard_normal(50), rng=np.random.default_rng(s)) for s in range(100)]
    right = [f for f in found if f.kind == "noise"]
    assert len(right) >= 95
    # the added 18 of sqrt(18^2 + 2^2 + 1)
    assert sum(f.low <= 18.0 <= f.high for f in right) >= binom.ppf(3e-5, len(right), 0.95)
    assert np.mean([f.size for f in right]) == pytest.approx(18.0, abs=4 * 18 / np.sqrt(2 * 50 * 100) + 0.3)


def test_a_short_excursion_is_a_spike_once_it_is_over() -> None:
    assert named([9.0, 9.0]).kind == "spikes"
    begun = named([9.0, 9.0], over=False)
    assert begun.kind == "bias" and begun.alternatives == ("spikes", "drift", "noise")
    assert named([9.0, 0.0, 0.0, 0.0]).kind == "spikes"  # with the samples in which it is trusted again


def test_each_event_of_spikes_has_its_own_height_and_sign() -> None:
    error, sd = np.array([0.1, -20.0, 0.0]), np.ones(3)
    found = resized(Named("spikes", 18.0, 15.0, 21.0, ("noise",)), error, sd, NoiseOf(1.0))
    assert found == Named("spikes", -20.0, pytest.approx(-21.96), pytest.approx(-18.04), ("noise",))
    spikes = Named("spikes", 18.0, 15.0, 21.0)
    assert resized(spikes, np.array([0.1, np.nan]), np.ones(2), NoiseOf(1.0)) is spikes  # the detector waits for more
    bias = Named("bias", 1.0, 0.5, 1.5)
    assert resized(bias, error, sd, NoiseOf(1.0)) is bias


def test_readings_that_repeat_or_are_missing() -> None:
    y = np.full(50, 3.0)
    frozen = named(SHAPES["drift"], y=y)
    assert frozen.kind == "freeze" and frozen.size > 15
    assert named(SHAPES["drift"], y=y, still=True).kind == "drift"  # the sensor repeats itself when healthy, too
    y = np.where(np.arange(50) % 3 == 0, 1.0, np.nan)
    assert named(SHAPES["bias"], y=y).kind == "dropout"
    nothing = name(np.full(5, np.nan), np.full(5, np.nan), NoiseOf(1.0), np.arange(5.0), still=False, over=True)
    assert nothing.kind == "" and np.isnan(nothing.size)
