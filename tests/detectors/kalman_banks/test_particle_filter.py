"""The particle filter as a detector: against the Kalman filter on a linear plant, against quadrature on a nonlinear one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors.detector import Decision, Detector, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.particle_filter import ParticleFilter
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.detectors.storage import load_state, save_state
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

SIZE, RUNS = 1000, 200


def gaps() -> tuple[Plant, Array, Array, Array]:
    """A linear plant of three sensors, and one series of readings with gaps, one step without readings."""
    plant = chain(3)
    t, _, y, u = readings(plant, 6, 1, seed=4)
    y = y[:, 0].copy()
    y[2], y[3, 0], y[4, 1:] = np.nan, np.nan, np.nan
    return plant, t, y, u[:, 0]


@pytest.fixture(scope="module")
def clouds() -> Decision:
    """The same readings through RUNS filters with different particles."""
    plant, t, y, u = gaps()
    detector = ParticleFilter(plant, size=SIZE, accommodate=False)
    same = np.broadcast_to(y[:, None], (len(t), RUNS, y.shape[-1]))
    return run(detector, detector.init((RUNS,), seed=3), t, same, u, covariance=True)[1]


def assert_near(found: Array, expected: Array, unit: Array) -> None:
    """The mean of the runs within 4.5 standard errors, and a bias of 5 / SIZE of the unit: weights are ratios of means."""
    allowed = 4.5 * found.std(axis=0, ddof=1) / np.sqrt(RUNS) + 5 / SIZE * unit
    assert np.all(np.abs(found.mean(axis=0) - expected) <= allowed), (found.mean(axis=0) - expected) / allowed


@pytest.mark.parametrize("k", range(6))
def test_on_a_linear_plant_it_is_the_kalman_filter(clouds: Decision, k: int) -> None:
    plant, t, y, u = gaps()
    central = CentralFilter(plant)
    kalman = run(central, central.init(), t, y, u, covariance=True)[1]
    assert kalman.covariance is not None and clouds.covariance is not None
    sigma = np.sqrt(np.diagonal(kalman.covariance[k]))
    assert_near(clouds.estimate[k], kalman.estimate[k], sigma)
    assert_near(clouds.covariance[k], kalman.covariance[k], np.outer(sigma, sigma))
    filled = np.isnan(y[k])
    np.testing.assert_array_equal(clouds.reconstruction[k][:, ~filled], np.broadcast_to(y[k, ~filled], (RUNS, (~filled).sum())))
    assert_near(clouds.reconstruction[k][:, filled], kalman.reconstruction[k, filled], sigma[filled])
    if np.all(filled):
        assert np.isnan(clouds.nis[k]).all()
    else:
        assert_near(clouds.nis[k], kalman.nis[k], np.asarray(2 * kalman.nis[k] + 1))


@pytest.mark.parametrize("k", range(6))
def test_weighted_without_a_sensor_it_is_the_kalman_filter_without_it(clouds: Decision, k: int) -> None:
    plant, t, y, u = gaps()
    bank = LeaveOneOutBank(plant, window=1, accommodate=False)
    exact = run(bank, bank.init(), t, y, u)[1]
    read = np.isfinite(y[k])
    np.testing.assert_array_equal(np.isnan(clouds.residual[k]), np.broadcast_to(~read, (RUNS, 3)))
    sigma = exact.threshold[k, read] / ParticleFilter(plant)._alpha
    assert_near(clouds.residual[k][:, read], exact.residual[k, read], sigma)
    assert_near(clouds.threshold[k][:, read], exact.threshold[k, read], exact.threshold[k, read])


def square() -> Plant:
    """A constant standard normal state, read twice as its square: the slope at its mean is 0."""
    return Plant(
        name="square",
        states=(Signal("x", "1", 0.0, -10.0, 10.0),),
        inputs=(),
        sensors=(Sensor("a", "square", "1", sigma=0.3), Sensor("b", "square", "1", sigma=0.5)),
        step=lambda t, x, u, dt: x,
        output=lambda t, x, u: np.concatenate([x**2, x**2], axis=-1),
        dt=1.0,
        x0=np.zeros(1),
        initial_cov=np.ones(1),
        process_cov=np.full(1, 1e-12),
    )


def test_two_peaks_have_the_weights_of_the_integral() -> None:
    """E[x^2 | y_b], its variance and E[x^2 | y_a, y_b] by quadrature; an extended Kalman filter gets no information here."""
    plant, y = square(), np.array([1.6, 2.1])
    x = np.linspace(-8, 8, 20001)
    prior, r = np.exp(-0.5 * x**2), plant.sensor_cov
    likelihood = np.exp(-0.5 * (y[:, None] - x**2) ** 2 / r[:, None])

    def mean(value: Array, weight: Array) -> float:
        return float(trapezoid(value * weight, x) / trapezoid(weight, x))

    detector = ParticleFilter(plant, size=SIZE, accommodate=False)
    _, d = detector.step(detector.init((RUNS,), seed=5), 1.0, np.tile(y, (RUNS, 1)), np.zeros(0))
    for i, weight in enumerate(prior * likelihood[::-1]):
        expected = mean(x**2, weight)
        sigma = np.sqrt(mean((x**2 - expected) ** 2, weight) + r[i])
        assert_near(d.residual[:, i], np.asarray(y[i] - expected), np.asarray(sigma))
        assert_near(d.threshold[:, i] / detector._alpha, sigma, sigma)
    assert d.covariance is not None
    second = mean(x**2, prior * likelihood[0] * likelihood[1])
    assert_near(d.estimate[:, 0], np.zeros(()), np.sqrt(second))
    assert_near(d.covariance[:, 0, 0], np.asarray(second), np.asarray(second))
    extended = CentralFilter(plant)
    _, blind = extended.step(extended.init(), 1.0, y, np.zeros(0))
    assert blind.estimate[0] == 0 and blind.covariance is not None and blind.covariance[0, 0] == pytest.approx(1.0)


def test_the_budget_of_false_alarms_holds_and_is_nearly_used() -> None:
    plant, budget = chain(4), 0.05
    t, _, y, u = readings(plant, 80, 40, seed=1)
    detector = ParticleFilter(plant, size=500, false_alarm=budget, accommodate=False)
    _, d = run(detector, detector.init((40,)), t, y, u)
    error = 3 * np.sqrt(budget / d.alarm.size)  # leave-one-out innovations are white; Bonferroni is hardly conservative
    assert 0.8 * budget - error < d.alarm.mean() <= budget + error
    assert d.nis.mean() == pytest.approx(1.0, abs=3 * np.sqrt(2 / 4 / d.nis.size) + 1 / 500)
    assert not d.diverged.any()


def test_jumps_are_isolated_with_their_size_and_replaced() -> None:
    plant = chain(8, process=0.5)
    t, _, y, u = readings(plant, 30, 10, seed=2)
    faulty = y.copy()
    faulty[20:, :, 2] += 15.0
    faulty[20:, :, 5] -= 25.0
    detector = ParticleFilter(plant, size=3000)
    _, d = run(detector, detector.init((10,)), t, faulty, u)
    expected = np.zeros(8, bool)
    expected[[2, 5]] = True
    during = d.isolated[20:]
    # 1e-3 of 100 steps: two false isolations are the 99.98 % point of a Poisson law of mean .1
    assert np.sum(np.any(during != expected, axis=-1)) <= 2
    # a size has the noise (1) and the error of the other readings; the accommodated reading only the latter
    sizes = d.fault_size[20:][..., [2, 5]]
    np.testing.assert_allclose(np.nanmean(sizes, axis=(0, 1)), [15.0, -25.0], atol=1.0)
    error = (d.reconstruction - y)[20:][..., [2, 5]]
    assert np.sqrt(np.mean(error**2)) < 2.0
    healthy = np.flatnonzero(~expected)
    np.testing.assert_array_equal(
        d.reconstruction[20:][..., healthy][~during[..., healthy]], faulty[20:][..., healthy][~during[..., healthy]]
    )


def test_the_same_seed_gives_the_same_bits_and_a_saved_state_goes_on_with_them(tmp_path: Any) -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 8, 3, seed=0)
    y = np.where(np.random.default_rng(1).random(y.shape) < 0.2, np.nan, y)
    detector: Detector = ParticleFilter(plant, size=300)
    state, whole = run(detector, detector.init((3,), seed=7), t, y, u)
    middle, _ = run(detector, detector.init((3,), seed=7), t[:4], y[:4], u[:4])
    save_state(tmp_path / "state.npz", detector, middle)
    again, rest = run(detector, load_state(tmp_path / "state.npz", detector), t[4:], y[4:], u[4:])
    for one, other in zip(leaves(state), leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(whole.estimate[4:], rest.estimate)
    np.testing.assert_array_equal(whole.residual[4:], rest.residual)
    _, other_seed = run(detector, detector.init((3,), seed=8), t, y, u)
    assert np.any(whole.estimate != other_seed.estimate)


def test_a_run_without_a_batch_and_one_that_diverges_alone() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 3, 2, seed=0)
    detector = ParticleFilter(plant, size=200)
    single = detector.step(detector.init(), float(t[0]), y[0, 0], u[0, 0])[1]
    assert single.estimate.shape == (2,) and single.isolated.shape == (4,) and single.alarm.shape == ()
    state = detector.init((2,))
    state.memory.members[1] = np.nan
    after, d = detector.step(state, float(t[0]), y[0], u[0])
    assert d.diverged.tolist() == [False, True] and np.isfinite(d.estimate[0]).all() and np.isnan(d.estimate[1]).all()
    _, later = detector.step(after, float(t[1]), y[1], u[1])
    assert later.diverged.tolist() == [False, True]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"size": 1}, "1 particles; expected at least 2"),
        ({"false_alarm": 0.0}, "strictly between 0 and 1"),
        ({"max_faults": 4}, "plant 'two-tanks' has 4 sensors"),
    ],
)
def test_bad_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(ParticleFilter(tanks()), **settings)
