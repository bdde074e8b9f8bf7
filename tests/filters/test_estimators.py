"""Considered states in the filters and the detectors on them: a filter after Schmidt, and who cannot have them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from toy_plants import chain, readings, tanks

from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.moving_horizon_bank import MovingHorizon
from fusion_sfdia.detectors.kalman_banks.multiple_model import MultipleModel
from fusion_sfdia.detectors.kalman_banks.particle_filter import ParticleFilter
from fusion_sfdia.detectors.kalman_banks.sequential_bank import SequentialBank
from fusion_sfdia.detectors.stochastic_thresholds.monte_carlo import MonteCarlo
from fusion_sfdia.filters import ukf
from fusion_sfdia.filters.estimators import Ensemble, Extended, GaussianParticles, Reading, Unscented, step_stream
from fusion_sfdia.filters.filterpy_estimators import FilterpyExtended, FilterpyUnscented
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import Uncertainty

Array = NDArray[Any]
STEPS = 25
HELD = np.array([1, 4])
PLANT = chain(5, sensors=7)
CONSIDERING = replace(PLANT, uncertainty=Uncertainty(considered=("x4", "x1")))


def schmidt(plant: Plant, y: Array) -> tuple[list[Array], list[Array]]:
    """Estimates and covariances of the filter with the optimal gain whose rows HELD are 0, by Joseph's form."""
    F = plant.step_jacobian_at(0.0, plant.x0, np.zeros(0), 1.0)
    H = plant.output_jacobian_at(0.0, plant.x0, np.zeros(0))
    x, P, R = plant.x0, np.diag(plant.initial_cov), np.diag(plant.sensor_cov)
    estimates, covariances = [], []
    for reading in y:
        x, P = F @ x, F @ P @ F.T + np.diag(plant.process_cov)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        K[HELD] = 0.0
        A = np.eye(5) - K @ H
        x, P = x + K @ (reading - H @ x), A @ P @ A.T + K @ R @ K.T
        estimates.append(x)
        covariances.append(P)
    return estimates, covariances


EVERY = (
    *(Extended(), Unscented(redraw=True), Unscented(redraw=False), FilterpyExtended(), FilterpyUnscented()),
    *(Ensemble(), GaussianParticles(), MonteCarlo()),
)


@pytest.mark.parametrize("estimator", EVERY, ids=str)
def test_a_filter_draws_random_numbers_if_and_only_if_it_states_so(estimator: Any) -> None:
    """Those that draw none are handed one generator for all steps."""
    plant, rng = tanks(), step_stream(3, 5)
    before, u = str(rng.bit_generator.state), plant.input_at(0.0)[None]
    core = estimator.start(plant, (1,), rng)
    prior = estimator.predict(plant, core, 0.0, u, plant.dt, rng)
    joint = estimator.joint(plant, prior, plant.dt, u)
    estimator.assimilate(plant, prior, Reading(plant.dt, joint.y, u), joint.x, joint.P, rng)
    assert estimator.is_random == (str(rng.bit_generator.state) != before)


@pytest.mark.parametrize("estimator", [Unscented(redraw=True), Unscented(redraw=False), Ensemble()], ids=str)
def test_readings_that_are_states_have_the_moments_of_their_points(estimator: Unscented | Ensemble) -> None:
    """A plant with a nonlinear step: the same as where its output is not known to be linear."""
    linear = registry.plant("gas-pipeline")
    other = replace(linear, numerics=replace(linear.numerics, output_jacobian=None))
    u = linear.input_at(0.0)[None]
    found, expected = (
        estimator.joint(plant, estimator.predict(plant, core, 0.0, u, plant.dt, np.random.default_rng(1)), plant.dt, u)
        for plant in (linear, other)
        for core in [estimator.start(plant, (1,), np.random.default_rng(0))]
    )
    assert linear.linear[1] and not other.linear[1]
    size = np.sqrt(np.diagonal(expected.S, axis1=-2, axis2=-1))[0]
    # offsets of points, alpha = 1e-3 of a standard deviation, are differences of numbers of the size of the readings
    eps = np.finfo(float).eps * 1e3 * np.max(np.abs(expected.y) / size) * 127
    for name, unit in (("x", size), ("y", size), ("P", np.outer(size, size)), ("S", np.outer(size, size))):
        difference = (getattr(found, name) - getattr(expected, name)) / unit
        np.testing.assert_allclose(difference, 0.0, rtol=0, atol=eps, err_msg=name)


@pytest.mark.parametrize(
    "make",
    [
        CentralFilter,
        lambda plant: CentralFilter(plant, Unscented(SigmaPoints(alpha=1.0))),
        lambda plant: LeaveOneOutBank(plant, accommodate=False),
        lambda plant: SequentialBank(plant, accommodate=False),
        lambda plant: MovingHorizon(plant, accommodate=False),
    ],
    ids=["kf-chi2", "unscented", "loo-glr", "sequential", "mhe-l1"],
)
def test_the_estimate_is_that_of_a_filter_after_schmidt(make: Any) -> None:
    _, _, y, u = readings(PLANT, STEPS, 1, seed=5)
    detector = make(CONSIDERING)
    _, found = run(detector, detector.init((1,)), np.arange(1.0, STEPS + 1), y, u, covariance=True)
    x, P = schmidt(PLANT, y[:, 0])
    assert found.covariance is not None
    for k in range(STEPS):
        # S, conditioned below 100, is solved with in each step; numbers of order one
        close: dict[str, float] = {"rtol": 0, "atol": rounding(100.0, 30 * (k + 1))}
        np.testing.assert_allclose(found.estimate[k, 0], x[k], **close)
        np.testing.assert_allclose(found.covariance[k, 0], P[k], **close)


def test_a_bank_considers_while_it_leaves_a_sensor_out() -> None:
    """After Schmidt without the sensor, as if its readings were missing: a large bias is eliminated in its first sample."""
    _, _, y, u = readings(PLANT, STEPS, 1, seed=6)
    faulty, without = y.copy(), y.copy()
    faulty[10, 0, 2] += 100.0
    without[10, 0, 2] = np.nan
    found = []
    for given in (faulty, without):
        bank = LeaveOneOutBank(CONSIDERING, window=1)
        found.append(run(bank, bank.init((1,)), np.arange(1.0, 12.0), given[:11], u[:11], covariance=True)[1])
    assert found[0].isolated[10, 0, 2]
    close: dict[str, float] = {"rtol": 0, "atol": rounding(100.0, 30 * 11) * 100.0}  # of a bias of 100
    np.testing.assert_allclose(found[0].estimate[10], found[1].estimate[10], **close)
    assert found[0].covariance is not None and found[1].covariance is not None
    np.testing.assert_allclose(found[0].covariance[10], found[1].covariance[10], **close)


def test_the_uncertainty_of_considered_states_counts() -> None:
    """In the covariance and in the one-sample test; over time their innovations are correlated, as the gain is not optimal."""
    plant = replace(PLANT, initial_cov=np.array([1.0, 9.0, 1.0, 1.0, 9.0]), uncertainty=CONSIDERING.uncertainty)
    t, x, y, u = readings(plant, 50, 400, seed=7)
    bank = LeaveOneOutBank(plant, window=1, false_alarm=0.01, accommodate=False)
    _, found = run(bank, bank.init((400,)), t, y, u, covariance=True)
    of_runs = found.alarm.mean(axis=0)  # runs are independent, their samples are not
    assert of_runs.mean() < 0.01 + 3 * of_runs.std() / 20
    assert found.covariance is not None
    error = found.estimate - x
    nees = np.einsum("kbi,kbij,kbj->b", error, np.linalg.inv(found.covariance), error) / (50 * 5)
    assert abs(nees.mean() - 1) < 3 * nees.std() / 20


@pytest.mark.parametrize("estimator", [Extended(), Unscented()])
def test_without_considered_states_the_joint_has_none(estimator: Extended | Unscented) -> None:
    rng = np.random.default_rng(0)
    for plant, expected in ((PLANT, None), (CONSIDERING, HELD)):
        prior = estimator.predict(plant, estimator.start(plant, (1,), rng), 0.0, np.zeros((1, 0)), 1.0, rng)
        np.testing.assert_array_equal(estimator.joint(plant, prior, 1.0, np.zeros((1, 0))).considered, expected)


@pytest.mark.parametrize("redraw", [True, False])
def test_unscented_moments_of_a_linear_plant_are_those_of_sigma_points_and_shared_by_all_runs(redraw: bool) -> None:
    rng, u, points = np.random.default_rng(0), np.zeros((3, 0)), SigmaPoints(alpha=1.0)
    estimator = Unscented(points, redraw)
    core = estimator.start(PLANT, (3,), rng)._replace(x=rng.normal(size=(3, 5)))
    prior = estimator.predict(PLANT, core, 0.0, u, 1.0, rng)
    found = estimator.joint(PLANT, prior, 1.0, u)
    x, P, ahead = ukf.predict(points, core.x, core.P, lambda s: PLANT.step(0.0, s, u[:1], 1.0), PLANT.process_cov)
    of_points = None if redraw else ahead
    expected = ukf.joint(points, x, P, lambda s: PLANT.output(1.0, s, u[:1]), PLANT.sensor_cov, of_points)
    for name in ("x", "P", "y", "S", "C"):
        given, wanted = getattr(found, name), getattr(expected, name)
        # sums over 11 points of numbers up to 4
        np.testing.assert_allclose(given, wanted, rtol=0, atol=4 * 11 * np.finfo(float).eps, err_msg=name)
    assert found.S.strides[0] == found.P.strides[0] == 0


@pytest.mark.parametrize(
    "make",
    [
        lambda plant: FusingBank(plant, thresholds=(1.0,) * 7),
        MultipleModel,
        ParticleFilter,
        lambda plant: CentralFilter(plant, Ensemble()).init(),
    ],
    ids=["fusing", "multiple-model", "particle", "ensemble"],
)
def test_mixtures_and_ensembles_refuse_considered_states(make: Any) -> None:
    with pytest.raises(NotApplicableError, match=r"plant 'chain' has considered states \(x1, x4\)"):
        made: Detector = make(CONSIDERING)
        del made
