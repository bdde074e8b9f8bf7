"""Leaving out and readmitting, against a literal implementation: one sensor at a time, likelihoods by SciPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from rounding import rounding
from scipy.stats import norm

from fusion_sfdia.detectors.exclusion import MEMORY, QUIET, Exclusion, exclude, none_excluded, readmit, restored

LIMIT, LEVEL = 9.0, 4.0  # three standard deviations; a likelihood ratio of e^4


@dataclass
class Sensor:
    """One sensor as the docstrings have it."""

    out: bool = False
    size: float = 0.0
    samples: int = 0
    evidence: float = 0.0
    quiet: int = 0

    def exclude(self, size: float) -> None:
        self.out, self.size, self.samples, self.evidence, self.quiet = True, size, 1, 0.0, 0

    def readmit(self, error: float, variance: float) -> None:
        if not self.out or np.isnan(error):
            return
        deviation = np.sqrt(variance)
        if error**2 > LIMIT * variance:  # beyond the limit of healthy readings: the evidence is reset
            self.evidence, self.quiet = 0.0, 0
        else:
            assumed = self.size if abs(self.size) > deviation else np.copysign(deviation, self.size)
            ratio = norm.logpdf(error, 0.0, deviation) - norm.logpdf(error, assumed, deviation)
            self.evidence = max(self.evidence + ratio, 0.0)
            self.quiet += 1
        if self.evidence == 0.0:
            self.samples += 1
            self.size += (error - self.size) / min(self.samples, MEMORY)
        if self.evidence > LEVEL and self.quiet >= QUIET:
            self.out, self.size, self.samples, self.evidence = False, 0.0, 0, 0.0


def errors(steps: int, *batch: int) -> np.ndarray:
    """Errors in standard deviations: faults of either sign that come, fade and go, readings that are missing, and outliers."""
    rng = np.random.default_rng(0)
    fault = np.where(rng.random((steps, *batch)) < 0.1, rng.normal(size=(steps, *batch)) * 8, np.nan)
    for k in range(1, steps):
        fault[k] = np.where(np.isnan(fault[k]), np.where(rng.random(batch) < 0.1, 0.0, fault[k - 1]), fault[k])
    error = np.nan_to_num(fault) + rng.normal(size=fault.shape)
    return np.where(rng.random(error.shape) < 0.1, np.nan, error)


def test_readmission_is_the_literal_one() -> None:
    steps, batch = 400, (3, 5)
    rng = np.random.default_rng(1)
    e, variance = errors(steps, *batch), rng.uniform(0.25, 4.0, (steps, *batch))
    e = e * np.sqrt(variance)
    faulty = (rng.random(e.shape) < 0.05) & np.isfinite(e)
    now, literal = none_excluded((3,), 5), {i: Sensor() for i in np.ndindex(batch)}
    readmitted = voided = 0
    # a sum of up to `steps` ratios (e - a)^2 - e^2 of e, a up to 30 standard deviations
    near = rounding(30**2, steps)
    for k in range(steps):
        held = np.array([literal[i].evidence for i in np.ndindex(batch)]).reshape(batch)
        before, now = now, readmit(now, e[k], variance[k], LIMIT, LEVEL)
        for i, sensor in literal.items():
            sensor.readmit(e[k][i], variance[k][i])
        readmitted += int(np.sum(before.out & ~now.out))
        voided += int(np.sum((held > 1.0) & now.out & (now.evidence == 0.0)))
        now = exclude(now, faulty[k], e[k])
        for i, sensor in literal.items():
            if faulty[k][i]:
                sensor.exclude(e[k][i])
            for name in Exclusion._fields:
                if name == "quiet" and not sensor.out:  # of a sensor in use nothing is counted
                    continue
                found, expected = getattr(now, name)[i], getattr(sensor, name)
                assert found == pytest.approx(expected, rel=0, abs=near), (k, i, name)
    assert readmitted > 50 and voided > 20


def test_an_implausible_reading_voids_the_evidence_of_health() -> None:
    """Fault of 10: a healthy reading weighs (10^2 - 0) / 2 = 50; one at -4 is nearer to healthy, too, but no healthy one."""
    now = exclude(none_excluded((), 1), np.array([True]), np.array([10.0]))
    one = np.ones(1)
    gathered = readmit(now, 0 * one, one, LIMIT, 60.0)
    assert gathered.out[0] and gathered.evidence[0] == 50.0
    assert not readmit(gathered, 0 * one, one, LIMIT, 60.0).out[0]  # 100 after a second
    void = readmit(gathered, -4 * one, one, LIMIT, 60.0)
    assert void.out[0] and void.evidence[0] == 0.0 and void.quiet[0] == 0
    after = readmit(void, 0 * one, one, LIMIT, 60.0)
    assert after.out[0] and after.quiet[0] == 1  # the count of quiet samples starts again


def test_a_missing_reading_changes_nothing() -> None:
    now = readmit(exclude(none_excluded((), 1), np.array([True]), np.array([10.0])), np.zeros(1), np.ones(1), LIMIT, 60.0)
    for a, b in zip(readmit(now, np.array([np.nan]), np.ones(1), LIMIT, 60.0), now, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_size_follows_the_fault_over_the_last_samples_and_rests_while_evidence_gathers() -> None:
    now = exclude(none_excluded((), 1), np.array([True]), np.array([20.0]))
    size, one = 20.0, np.ones(1)
    for k, error in enumerate([20.0, 22.0, 24.0, 26.0, 28.0, 30.0, 32.0], start=2):
        now = readmit(now, error * one, one, LIMIT, 1e9)
        size += (error - size) / min(k, MEMORY)
        assert now.size[0] == pytest.approx(size, rel=rounding(1, 20))
    rests = readmit(now, one, one, LIMIT, 1e9)
    assert rests.evidence[0] > 0 and rests.size[0] == now.size[0]


def test_a_sensor_left_out_for_nothing_comes_back() -> None:
    """A size estimated as 0 is taken as one standard deviation: readings of 0 then weigh 1/2 each."""
    now, one = exclude(none_excluded((), 1), np.array([True]), np.array([0.0])), np.ones(1)
    for k in range(1, 9):
        now = readmit(now, 0 * one, one, LIMIT, LEVEL)
        assert now.out[0] and now.evidence[0] == k / 2
    assert not readmit(now, 0 * one, one, LIMIT, LEVEL).out[0]


def test_a_size_is_averaged_over_five_samples_and_readmission_takes_two_quiet_ones() -> None:
    """Size 10, reading 20: (20 - 10) / 5 is learned. Each reading of 0 weighs 10^2 / 2 = 50, more than the level of 4."""
    one = np.ones(1)
    now = Exclusion(np.array([True]), 10 * one, 100 * one, 0 * one, 0 * one)
    assert readmit(now, 20 * one, one, LIMIT, LEVEL).size[0] == 12.0
    first = readmit(now, 0 * one, one, LIMIT, LEVEL)
    assert first.out[0] and first.evidence[0] == 50.0
    assert not readmit(first, 0 * one, one, LIMIT, LEVEL).out[0]


def test_a_reading_at_the_limit_is_plausible_and_a_fault_without_sign_counts_as_positive() -> None:
    one = np.ones(1)
    large, none = (Exclusion(np.array([True]), size * one, one, 0 * one, 0 * one) for size in (10.0, 0.0))
    at_limit = readmit(large, 3 * one, one, LIMIT, 60.0)
    assert at_limit.quiet[0] == 1 and at_limit.evidence[0] == ((3 - 10) ** 2 - 3**2) / 2
    assert readmit(none, -0.5 * one, one, LIMIT, 60.0).evidence[0] == ((-0.5 - 1) ** 2 - 0.5**2) / 2


def test_a_restored_sensor_is_as_if_it_had_not_been_left_out() -> None:
    """And the others as they were: sensor 0 is restored, 1 stays out, 2 was not out."""
    out = exclude(none_excluded((), 3), np.array([True, True, False]), np.array([5.0, -7.0, 0.0]))
    out = readmit(out, np.array([0.1, 0.2, 0.3]), np.ones(3), LIMIT, 1e9)
    assert np.all(out.evidence[:2] > 0) and np.all(out.quiet[:2] == 1)
    now = restored(out, np.array([True, False, True]))
    for after, before, never in zip(now, out, none_excluded((), 3), strict=True):
        assert after[1] == before[1] and after[0] == never[0] and after[2] == never[2]
    assert now.out.tolist() == [False, True, False]
    again, first = (exclude(e, np.array([True, False, False]), np.full(3, 2.0)) for e in (now, none_excluded((), 3)))
    for after, never in zip(again, first, strict=True):
        assert after[0] == never[0]


def test_restoring_nothing_or_in_some_runs_changes_no_other() -> None:
    out = exclude(none_excluded((2,), 2), np.array([[True, True], [True, False]]), np.full((2, 2), 3.0))
    for after, before in zip(restored(out, np.zeros((2, 2), bool)), out, strict=True):
        np.testing.assert_array_equal(after, before)
    one = restored(out, np.array([[True, True], [False, False]]))
    for after, before in zip(one, out, strict=True):
        assert not np.any(after[0])
        np.testing.assert_array_equal(after[1], before[1])
