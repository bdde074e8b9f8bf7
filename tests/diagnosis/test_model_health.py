"""Whether the model fits a log."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import ndtr, ndtri
from toy_plants import chain

from fusion_sfdia.diagnosis.hindsight import Hindsight
from fusion_sfdia.diagnosis.model_health import Health, health_of, limit_of
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor
from fusion_sfdia.plant.slow_noise import SlowNoise

NAMES = ("a", "b", "c", "d")
PLANT = replace(chain(4), sensors=tuple(Sensor(name, f"x{i}", sigma=1.0) for i, name in enumerate(NAMES)))
START = np.array([0])


def health(z: np.ndarray, plant: Plant = PLANT, **settings: Any) -> Health:
    """The health of a log with standardised innovations z (K, 4)."""
    known = np.isfinite(z)
    nis = np.where(known.any(axis=1), np.nansum(z**2, axis=1) / np.maximum(known.sum(axis=1), 1), np.nan)
    after = Hindsight(z, np.ones_like(z), z, nis, known.sum(axis=1))
    return health_of(plant, after, START, 1e-3, tuple(settings.get("remarks", ())))


def test_at_the_limit_false_alarms_are_ten_times_as_frequent() -> None:
    for rate, sensors in ((1e-3, 4), (1e-2, 63), (1e-5, 1)):
        f = rate / sensors
        q = -ndtri(f / 2)
        assert 2 * ndtr(-q / np.sqrt(limit_of(rate, sensors))) == pytest.approx(10 * f, rel=1e-9)
    assert 1 < limit_of(0.9, 1) < 10


def test_white_innovations_fit_and_larger_or_slower_ones_do_not() -> None:
    z = np.random.default_rng(0).standard_normal((600, 4))
    fits = health(z)
    assert not fits.suspect and not fits.excess and fits.nis == pytest.approx(1.0, abs=4 * np.sqrt(2 / 2320))
    assert fits.line.startswith("model fits: NIS ") and fits.samples == 580
    large = health(2 * z)
    assert large.suspect and large.nis == pytest.approx(4 * fits.nis) and set(large.excess) == set(NAMES)
    assert large.line.startswith("model suspect: NIS 4.0") and "4 of 4 sensors vary more or slower than stated" in large.line
    slow = z.copy()  # rho = 0.6 and variance 1: sums vary (1 + 0.6) / (1 - 0.6) = 4 times as much
    for k in range(1, 600):
        slow[k] = 0.6 * slow[k - 1] + 0.8 * z[k]
    assert health(slow).suspect and health(slow).nis < limit_of(1e-3, 4)
    assert next(iter(health(slow).excess.values())) == pytest.approx(4.0, rel=4 * np.sqrt(2 / 580 + 4 / 580 / 0.64))
    one = np.where(np.arange(4) == 2, slow, z)
    assert not health(one).suspect and set(health(one).excess) == {"c"}
    assert health(one).line.startswith("model fits, with reservations: ") and "1 of 4 sensors" in health(one).line
    quiet = health(0.5 * z)
    assert quiet.cautious and quiet.line.startswith("model cautious: ")


def test_slow_noise_that_is_stated_fits() -> None:
    """Of 100 logs whose second sensor has slow noise none is off; one that states none is, in all."""
    rng, q = np.random.default_rng(4), np.exp(-1 / 20)
    slow = SlowNoise(0.8, 20.0)
    stated = replace(PLANT, sensors=tuple(replace(s, noise=slow if s.name == "b" else None) for s in PLANT.sensors))
    found = []
    for _ in range(100):
        z = rng.standard_normal((600, 4))
        wandering = np.sqrt(0.8) * lfilter([np.sqrt(1 - q**2)], [1.0, -q], rng.standard_normal(600))
        z[:, 1] = np.sqrt(0.2) * z[:, 1] + wandering
        found.append([health(z, plant) for plant in (PLANT, stated)])
    assert all("b" in (*without.excess, *without.shifts) for without, _ in found)
    assert not any(fits.excess or fits.shifts for _, fits in found)


def test_healthy_logs_are_not_suspected() -> None:
    """500 logs of white innovations: a limit of 1.5 is more than 5 standard errors away."""
    rng = np.random.default_rng(1)
    assert not any(health(rng.standard_normal((120, 4))).suspect for _ in range(500))


def test_what_is_said_to_be_seen_is_seen() -> None:
    """Of 300 logs with the stated mismatch 0.977 are expected to be seen; 0.95 is 3 standard errors less."""
    rng = np.random.default_rng(2)
    visible = health(rng.standard_normal((620, 4))).visible
    assert f"{visible.spread:.2g} times as large as stated, or" in health(rng.standard_normal((620, 4))).line
    larger, later = np.array([1.0, 1.0, visible.spread, 1.0]), np.zeros((620, 4))
    later[250:550, 1] = -visible.shift  # half of those after the start, wherever it begins
    seen = np.zeros((300, 2))
    for k in range(len(seen)):
        z = rng.standard_normal((620, 4))
        assert not health(z).shifts and not health(z).excess
        seen[k] = set(health(larger * z).excess) == {"c"}, set(health(z + later).shifts) == {"b"}
    assert (seen.mean(axis=0) > 0.95).all()


def test_a_sensor_that_reads_off_or_has_hardly_a_reading_is_named() -> None:
    z = np.random.default_rng(3).standard_normal((600, 4))
    line = health(z + np.outer(np.linspace(-2.0, 2.0, 600), [0, 0, 0, 1])).line
    assert line.startswith("model fits, with reservations: ")
    assert "1 of 4 sensors read off for a part of the log: d (by " in line
    silent = z.copy()
    silent[30:, 2] = np.nan
    assert health(silent).untested == ("c",) and "; not tested: c; " in health(silent).line
    assert health(z + 2.0).suspect and set(health(z + 2.0).shifts) == set(NAMES)


def test_too_few_samples_are_not_tested_and_a_start_does_not_count() -> None:
    z = np.random.default_rng(0).standard_normal((100, 4))
    z[:20] *= 30  # the filter settles
    assert not health(z).suspect
    short = health(z[:30])
    assert not short.tested and short.line == "model not tested: 10 healthy samples are too few"
    assert health(np.full((100, 4), np.nan)).line == "model not tested: 0 healthy samples are too few"
    assert health(z, remarks=["the estimate diverged at 5 s"]).line.startswith("model suspect: the estimate diverged at 5 s; ")
