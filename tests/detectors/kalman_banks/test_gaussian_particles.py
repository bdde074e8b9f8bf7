"""Gaussian particle filters as local filters of the fusing bank."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank, Local
from fusion_sfdia.filters.estimators import Extended, GaussianParticles, standard_draws
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]


@pytest.mark.parametrize("literal", [False, True])
def test_on_a_linear_plant_it_is_the_kalman_filter(literal: bool) -> None:
    """All weights are the same and the draws have the moments: with a fault, missing readings, and isolation."""
    plant = chain(4, sensors=6)
    t, _, y, u = readings(plant, 20, 2, seed=8)
    y[4:8, 0, 2] = np.nan
    y[10:, 1, 3] += 30.0
    kalman = FusingBank(plant, Extended(), thresholds=tuple(0.5 * plant.sensor_sigma), literal=literal)
    particles = replace(kalman, estimator=GaussianParticles(40))
    (_, a), (_, b) = (run(bank, bank.init((2,), seed=4), t, y, u, covariance=True) for bank in (kalman, particles))
    np.testing.assert_array_equal(a.isolated, b.isolated)
    assert a.isolated[10:, 1, 3].any()
    # log weights are differences of squares below 1e3, so the weights differ by 1e-12; covariances are inverted twice
    np.testing.assert_allclose(a.estimate, b.estimate, atol=1e-9)
    np.testing.assert_allclose(a.residual, b.residual, atol=1e-9)
    assert a.covariance is not None and b.covariance is not None
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-9)


def test_local_posteriors_of_a_nonlinear_reading_are_those_of_numerical_integration() -> None:
    """A state that is read as its square and as its cube: moments of each leave-one-out filter by quadrature."""
    plant = Plant(
        "powers",
        step=lambda t, x, u, dt: x,
        output=lambda t, x, u: np.concatenate([x**2, x**3, x], axis=-1),
        states=(Signal("x"),),
        sensors=(Sensor("square", "x", sigma=0.3), Sensor("cube", "x", sigma=0.5), Sensor("plain", "x", sigma=0.4)),
        inputs=(),
        dt=1.0,
        x0=np.array([0.9]),
        initial_cov=np.array([0.2]),
        process_cov=np.array([0.05]),
    )
    y, size = np.array([1.4, 1.1, 0.8]), 20_000
    particles, kalman = (
        _local(FusingBank(plant, e, thresholds=(np.inf,) * 3), y) for e in (GaussianParticles(size), Extended())
    )
    grid = np.linspace(-2, 4, 20_001)
    assert particles.p is not None
    for i in range(3):
        log = -0.5 * (grid - 0.9) ** 2 / 0.25
        for j, (power, sigma) in enumerate([(2, 0.3), (3, 0.5), (1, 0.4)]):
            log = log - (0 if i == j else 0.5 * ((y[j] - grid**power) / sigma) ** 2)
        w = np.exp(log - log.max())
        w /= w.sum()
        mean = (w * grid).sum()
        variance = (w * (grid - mean) ** 2).sum()
        # four standard errors of a mean and a variance of effectively a quarter of the draws
        assert particles.x[0, i, 0] == pytest.approx(mean, abs=4 * np.sqrt(variance / (size / 4)))
        assert particles.p[0, i, 0, 0] == pytest.approx(variance, rel=4 * np.sqrt(2 / (size / 4)))
        assert abs(kalman.x[0, i, 0] - mean) > 4 * abs(particles.x[0, i, 0] - mean)


def _local(bank: FusingBank, y: Array) -> Local:
    """The local filters of a bank after its first readings y (N,) of a plant without inputs."""
    now, u = TimeStep(0.0, 1.0, 1.0, seed=2, k=1), np.zeros((1, 0))
    prior = bank._predict(bank.init((1,), seed=2).memory, now, u)
    joint = bank.estimator.joint(bank.plant, prior[0], 1.0, u)
    return bank._update(prior, joint, now, y[None], np.ones((1, y.size), bool), u)


def test_a_run_of_a_batch_has_the_bits_that_it_has_alone_and_its_seed_decides_them() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 10, 3, seed=1)
    bank = FusingBank(plant, GaussianParticles(100), thresholds=(np.inf,) * 4)
    _, together = run(bank, bank.init((3,), seed=7), t, y, u)
    _, alone = run(bank, bank.init(seed=7), t, y[:, 1], u[:, 1])
    _, other = run(bank, bank.init(seed=8), t, y[:, 1], u[:, 1])
    np.testing.assert_array_equal(together.estimate[:, 1], alone.estimate)
    assert np.any(other.estimate != alone.estimate)


def test_draws_have_mean_zero_and_unit_covariance_and_must_be_more_than_states() -> None:
    z = standard_draws(np.random.default_rng(0), 50, 7)
    np.testing.assert_allclose(z.mean(axis=0), 0, atol=1e-14)
    np.testing.assert_allclose(z.T @ z / 49, np.eye(7), atol=1e-13)
    plant = chain(8)
    with pytest.raises(ValueError, match="8 particles; expected more than the 8 states of 'chain'"):
        FusingBank(plant, GaussianParticles(8), thresholds=(np.inf,) * 8).init()
