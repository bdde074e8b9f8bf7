"""Fixed limits: what they learn, their false-alarm rate, and which faults they miss."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import betabinom
from toy_plants import Array, chain, tanks

from fusion_sfdia.detectors.data_driven import fixed_limits
from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.detectors.data_driven.healthy_limits import upper_limit
from fusion_sfdia.detectors.detector import Decision, joined, run
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.plant.plant import Plant

PLANT = tanks()
CENTRE = np.array([1.0, 1.0, 6e-4, 6e-4])
DETECTOR = FixedLimits(PLANT, CENTRE, 3 * PLANT.sensor_sigma, 2 * PLANT.sensor_sigma)


def judged(detector: FixedLimits, y: Array) -> Decision:
    """Decisions on readings (K, N)."""
    t, u = detector.plant.dt * np.arange(1, len(y) + 1), np.broadcast_to(detector.plant.input_at(0.0), (len(y), 1))
    return run(detector, detector.init(), t, y, u)[1]


def noise(plant: Plant, *shape: int, seed: int = 0) -> Array:
    count = len(plant.sensors)
    centre = plant.output(0.0, plant.x0, plant.input_at(0.0))
    return np.asarray(centre + plant.sensor_sigma * np.random.default_rng(seed).standard_normal((*shape, count)))


def test_by_hand() -> None:
    """In sigma of l1: limits 3 about the centre and 2 between readings."""
    steps = np.array([0.0, 1.5, -1.0, 2.0, 3.5, 2.5, 1.0])
    y = np.tile(CENTRE, (7, 1))
    y[:, 0] += PLANT.sensor_sigma[0] * steps
    d = judged(DETECTOR, y)
    # changes: none, 1.5, -2.5, 3, 1.5, -1, -1.5; the larger ratio counts
    expected = np.array([0.0, 1.5 / 2, -2.5 / 2, 3.0 / 2, 3.5 / 3, 2.5 / 3, -1.5 / 2])
    np.testing.assert_allclose(d.residual[:, 0] / d.threshold[:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(d.isolated[:, 0], [False, False, True, True, True, False, False])
    # in place of the three the last good reading, 1.5 sigma; sizes are less that
    np.testing.assert_allclose(d.reconstruction[2:5, 0], 1.0 + 1.5 * PLANT.sensor_sigma[0], rtol=1e-12)
    np.testing.assert_allclose(d.fault_size[2:5, 0] / PLANT.sensor_sigma[0], [-2.5, 0.5, 2.0], atol=1e-9)
    assert not d.isolated[:, 1:].any() and np.all(d.scores[:, 1:] < 1e-9)
    np.testing.assert_array_equal(d.estimate, np.broadcast_to(PLANT.x0, (7, 2)))


def test_after_a_missing_reading_only_the_level_is_checked() -> None:
    y = np.tile(CENTRE, (4, 1))
    y[1:3, 0] = np.nan
    y[3, 0] += 2.5 * PLANT.sensor_sigma[0]  # beyond the change of 2 sigma, within the level of 3
    d = judged(DETECTOR, y)
    assert not d.alarm.any() and np.isnan(d.residual[1:3, 0]).all()
    np.testing.assert_array_equal(d.reconstruction[1:3, 0], 1.0)
    assert d.scores[3, 0] == pytest.approx(2.5 / 3)
    first = judged(DETECTOR, np.full((1, 4), np.nan))
    np.testing.assert_array_equal(first.reconstruction[0], CENTRE)


def test_all_violating_sensors_are_isolated_together() -> None:
    y = CENTRE + np.array([4.0, -5.0, 0.0, 6.0]) * PLANT.sensor_sigma
    d = judged(DETECTOR, y[None])
    np.testing.assert_array_equal(d.isolated[0], [True, True, False, True])
    np.testing.assert_allclose(d.fault_size[0, [0, 1, 3]] / PLANT.sensor_sigma[[0, 1, 3]], [4.0, -5.0, 6.0], rtol=1e-9)


@pytest.mark.parametrize("rate", [0.2, 0.02])
def test_the_rate_of_false_alarms_is_at_most_the_one_asked_for(rate: float) -> None:
    plant = chain(6)
    train, fresh = noise(plant, 500, 8), noise(plant, 1000, 4, seed=1)
    detector = FixedLimits.fit(plant, train, rate)
    u = np.zeros((1000, 0))
    _, d = run(detector, detector.init((4,)), plant.dt * np.arange(1, 1001), fresh, u)
    # the factor is an order statistic of 2000 samples, whose rate is Beta distributed; changes share readings with their
    # neighbours, by which samples count by half. It wastes nothing: the lower quantile holds, too.
    law = betabinom(fresh.shape[0] * fresh.shape[1] // 2, rate * 1000, (1 - rate) * 1000)
    assert law.ppf(0.001) <= d.alarm.sum() / 2 <= law.ppf(0.999)


def test_as_many_samples_as_the_rate_needs_for_any_number_of_sensors() -> None:
    """11 quantities at 1e-3: the half of 2000 samples that judges has one above its limit, and 1998 are one too few."""
    plant = replace(chain(11), sensors=tuple(replace(s, quantity=s.name) for s in chain(11).sensors))
    train = noise(plant, 200, 10)
    detector = FixedLimits.fit(plant, train, 1e-3)
    assert len(plant.quantities) == 11
    judge = np.max(np.abs(train[1::2] - detector.centre) / detector.level, axis=-1)
    change = np.max(np.abs(np.diff(train, axis=0)[::2]) / detector.change, axis=-1)
    assert np.max(np.maximum(judge, change)) == pytest.approx(1.0, rel=1e-12)
    with pytest.raises(ValueError, match="990 healthy samples cannot set a limit that one in 1000 exceeds"):
        FixedLimits.fit(plant, train[:198], 1e-3)


def test_a_sensor_that_never_moves_is_limited_by_the_noise_that_it_declares() -> None:
    """l2 declares a sigma of .01 and a bound of .04; where its resolution is coarser, that counts."""
    train = noise(PLANT, 200, 5)
    train[..., 1] = 0.1 + 0.2  # of which a mean is not to the bit the number itself
    detector = FixedLimits.fit(PLANT, train, 0.01)
    largest = -ndtri(0.5 / 500) * 0.01  # of 500 Gaussian readings
    assert 0.9 * largest < detector.level[1] < 1.6 * largest and detector.level[1] < 0.04 * 1.6
    assert detector.change[1] == pytest.approx(np.sqrt(2) * detector.level[1], rel=1e-12)
    y = noise(PLANT, 20, seed=3)
    y[:, 1] = 0.3
    assert not judged(detector, y).isolated[:, 1].any()
    y[10:, 1] += 0.1
    np.testing.assert_array_equal(judged(detector, y).isolated[:, 1], np.arange(20) >= 10)
    coarse = noise(PLANT, 200, 5)
    coarse[..., 1] = 1.0
    coarse[1, 0, 1] = 1.5  # its resolution, seen among the samples that judge
    assert FixedLimits.fit(PLANT, coarse, 0.01).level[1] >= 0.5
    still = np.broadcast_to(CENTRE, (100, 2, 4))
    np.testing.assert_allclose(FixedLimits.fit(PLANT, still, 0.1).level, -ndtri(0.5 / 100) * PLANT.sensor_sigma, rtol=1e-12)


def test_limits_follow_the_movement_of_the_operation_and_then_hide_what_is_smaller() -> None:
    """A level that swings by 100 sigma: a bias of 30 sigma is isolated at its onset and not after it."""
    plant = chain(2)
    swing = 100.0 * np.sin(2 * np.pi * np.arange(2000) / 200)
    train = noise(plant, 2000, 2)
    train[..., 0] += swing[:, None]
    detector = FixedLimits.fit(plant, train, 0.02)
    assert detector.level[0] > 100.0 and detector.level[1] < 6.0
    # from one reading to the next a sine moves by pi at most, and noise by 6 sqrt 2 in 4000 samples
    assert detector.change[0] < 2 * (np.pi + 6 * np.sqrt(2))
    y = noise(plant, 40, seed=3)
    y[:, 0] += swing[:40] - 60.0  # on its way from -60 to 35
    y[20:, 0] += 30.0
    u = np.zeros((40, 0))
    _, d = run(detector, detector.init(), plant.dt * np.arange(1, 41), y, u)
    np.testing.assert_array_equal(np.flatnonzero(d.isolated[:, 0]), [20])
    # the last good reading is one step old: noise of two readings and a step of the sine
    assert d.fault_size[20, 0] == pytest.approx(30.0, abs=np.pi + 4 * np.sqrt(2))


def test_the_order_statistic() -> None:
    values = np.random.default_rng(0).permutation(np.arange(1.0, 100.0))  # 1 to 99
    assert upper_limit(values, 0.1) == 90.0  # a fresh one is above the 90th of 99 with probability 10 / 100
    assert upper_limit(values, 1 / 99) == 99.0
    with pytest.raises(ValueError, match="99 healthy samples cannot set a limit that one in 100 exceeds"):
        upper_limit(values, 0.01)


def test_missing_readings_in_the_healthy_data_are_left_out() -> None:
    train = noise(PLANT, 400, 4)
    holes = train.copy()
    holes[np.random.default_rng(2).random(train.shape) < 0.1] = np.nan
    whole, part = FixedLimits.fit(PLANT, train, 0.05), FixedLimits.fit(PLANT, holes, 0.05)
    # an order statistic at 1/20 of 800 samples, 40 of them above, of units of 800: a Gaussian's largest moves by a few tenths
    np.testing.assert_allclose(part.level / PLANT.sensor_sigma, whole.level / PLANT.sensor_sigma, atol=1.0)
    assert np.all(np.isfinite(part.change))


def test_what_is_refused() -> None:
    y = noise(PLANT, 100, 2)
    silent, infinite = y.copy(), y.copy()
    silent[..., 2] = np.nan
    infinite[3, 0, 0] = np.inf
    for bad, message in (
        (y[0, 0], r"y has shape \(4,\); expected healthy readings \(K, ..., 4\)"),
        (y[..., :3], r"y has shape \(100, 2, 3\)"),
        (y[:3], "of at least 4 times"),
        (silent, "healthy readings of q12 are missing; leave"),
        (infinite, "infinite readings"),
        ("healthy", "the readings are 'healthy'; expected t, y and u, a Log, a Recording"),
    ):
        with pytest.raises(ValueError, match=message):
            FixedLimits.fit(PLANT, bad, 0.1)
    with pytest.raises(ValueError, match="100 healthy samples cannot set a limit that one in 1000 exceeds"):
        FixedLimits.fit(PLANT, y, 1e-3)
    with pytest.raises(ValueError, match="false_alarm is 0; expected a probability"):
        FixedLimits.fit(PLANT, y, 0)
    for change, message in (
        ({"centre": np.ones(3)}, r"centre has shape \(3,\); expected 4 finite numbers, one a sensor of plant 'two-tanks'"),
        ({"level": np.full(4, np.nan)}, "expected 4 finite numbers"),
        ({"change": np.array([1.0, 0.0, 1.0, 1.0])}, "change has limits of 0 and more; expected positive ones"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(DETECTOR, **change)


def test_a_run_at_once_takes_little_more_memory_than_its_result() -> None:
    y, u = noise(PLANT, 100_000), np.tile(PLANT.input_at(0.0), (100_000, 1))
    t = PLANT.dt * np.arange(1, 100_001)
    tracemalloc.start()
    _, found = DETECTOR.steps(DETECTOR.init(), t, y, u)
    kept, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.isolated.any() and most < 1.5 * kept


@pytest.mark.parametrize("block", [7, 10_000])
def test_a_run_at_once_has_the_bits_of_its_steps(monkeypatch: pytest.MonkeyPatch, block: int) -> None:
    """Missing, absurd and faulty readings, an input beyond its limits, in two runs of steps after another."""
    monkeypatch.setattr(fixed_limits, "BLOCK", block)
    y = noise(PLANT, 60)
    y[3, 1], y[10:14], y[20:30, 0], y[40, 2], y[0] = np.nan, np.nan, 2.0, 1e30, np.nan
    t, u = PLANT.dt * np.arange(1, 61), np.tile(PLANT.input_at(0.0), (60, 1))
    u[33] = 1e6
    state, expected = run(DETECTOR, DETECTOR.init(), t, y, u)
    half, first = DETECTOR.steps(DETECTOR.init(), t[:25], y[:25], u[:25])
    after, second = DETECTOR.steps(half, t[25:], y[25:], u[25:])
    found = joined([first, second])
    assert expected.absurd.sum() == 1 and expected.absurd_input.sum() == 1
    for name in (
        "reconstruction",
        "residual",
        "threshold",
        "isolated",
        "fault_size",
        "absurd",
        "absurd_input",
        "capped",
        "nis",
    ):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for one, other in zip(leaves(after), leaves(state), strict=True):
        np.testing.assert_array_equal(one, other)
    assert DETECTOR.step(after, t[-1] + PLANT.dt, y[5], u[0])[0].steps == 61


def test_a_run_at_once_refuses_what_a_step_does() -> None:
    y, t, u = noise(PLANT, 5), PLANT.dt * np.arange(1, 6), np.tile(PLANT.input_at(0.0), (5, 1))
    for given, reason in (
        ((t[[0, 1, 1, 2, 3]], y, u), "a step of 0"),
        ((t, y[:, :3], u), "has 4 sensors"),
        ((t, y, u * np.nan), "not finite"),
    ):
        with pytest.raises(ValueError, match=reason):
            DETECTOR.steps(DETECTOR.init(), *given)
    with pytest.raises(ValueError, match="one run of at least one time"):
        DETECTOR.steps(DETECTOR.init(2), t, y, u)
