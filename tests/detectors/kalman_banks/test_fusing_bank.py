"""The fusing bank: its algebra against N filters run one by one, and the decisions of the paper's rules."""

from dataclasses import replace

import numpy as np
import pytest
from rounding import rounding
from toy_plants import chain, changed, readings, tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FEEDBACKS, FusingBank, disagreement
from fusion_sfdia.filters.enkf import EnKFSettings
from fusion_sfdia.filters.estimators import Ensemble, Estimator, Extended, Unscented
from fusion_sfdia.filters.gaussian import dense
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.plant.plant import Plant

KINDS = [
    Extended(),
    Unscented(),
    Unscented(SigmaPoints(alpha=0.5), redraw=False),
    Ensemble(EnKFSettings(size=8)),
    Ensemble(EnKFSettings(size=8, method="square-root")),
]


@pytest.mark.parametrize("estimator", KINDS, ids=["ekf", "ukf", "ukf-printed", "enkf", "enkf-root"])
@pytest.mark.parametrize("plant", [chain(6), chain(4, sensors=7), tanks()], ids=["chain", "general-h", "tanks"])
def test_algebra_equals_the_literal_bank_with_missing_readings(plant: Plant, estimator: Estimator) -> None:
    t, _, y, u = readings(plant, 25, 1, seed=1)
    y = y[:, 0].copy()
    y[5:9, 2] = np.nan
    y[12] = np.nan
    fast = FusingBank(plant, estimator, thresholds=tuple(2 * plant.sensor_sigma))
    slow = replace(fast, literal=True)
    _, a = run(fast, fast.init(seed=3), t, y, u[:, 0], covariance=True)
    _, b = run(slow, slow.init(seed=3), t, y, u[:, 0], covariance=True)
    # weights of 1/alpha^2 = 1e6 magnify the rounding of values of 100 scales; tolerance for 50 operations
    tolerance = 50 * np.finfo(float).eps * 1e2 * 1e6
    np.testing.assert_allclose(a.estimate / plant.state_scale, b.estimate / plant.state_scale, atol=tolerance, rtol=0)
    np.testing.assert_allclose(a.residual / plant.sensor_sigma, b.residual / plant.sensor_sigma, atol=tolerance, rtol=0)
    scale = np.outer(plant.state_scale, plant.state_scale)
    assert a.covariance is not None and b.covariance is not None
    np.testing.assert_allclose(a.covariance / scale, b.covariance / scale, atol=tolerance, rtol=0)
    np.testing.assert_array_equal(a.isolated, b.isolated)
    assert not a.diverged.any() and np.isnan(a.residual[6, 2])


@pytest.mark.parametrize("sensors", [4, 7])
def test_the_residual_is_the_printed_variance_of_what_the_local_filters_expect(sensors: int) -> None:
    """(19) of Shaheen 2024 as printed, a sum of N squares over N, from N textbook filters that each leave out one reading."""
    plant = chain(4, sensors=sensors)
    t, _, y, u = readings(plant, 12, 1, seed=7)
    y = y[:, 0].copy()
    y[5, 1] = np.nan
    bank = FusingBank(plant, Extended(), thresholds=(np.inf,) * sensors)
    f = plant.step_jacobian_at(0.0, plant.x0, u[0, 0], 1.0)
    h = plant.output_jacobian_at(0.0, plant.x0, u[0, 0])
    state = bank.init()
    for k in range(12):
        x, p = state.memory
        x, p = f @ x, f @ p @ f.T + np.diag(plant.process_cov)
        expected = []
        for i in range(sensors):
            rows = np.isfinite(y[k]) & (np.arange(sensors) != i)
            s = h[rows] @ p @ h[rows].T + np.diag(plant.sensor_cov[rows])
            local = x + p @ h[rows].T @ np.linalg.solve(s, (y[k] - h @ x)[rows])
            expected.append(h @ local)
        state, d = bank.step(state, float(t[k]), y[k], u[0, 0])
        for j in range(sensors):
            mean = sum(e[j] for e in expected) / sensors
            variance = sum((e[j] - mean) ** 2 for e in expected) / sensors
            # differences of numbers up to those read, after solving with S
            near = rounding(np.linalg.cond(s) * np.nanmax(np.abs(y)), 4 * (4 + sensors))
            printed = np.nan if np.isnan(y[k, j]) else np.sqrt(variance)
            assert d.residual[j] == pytest.approx(printed, rel=0, abs=near, nan_ok=True)


def test_unequal_beta_runs_literally_and_equal_beta_given_in_full_does_not() -> None:
    plant = chain(5)
    t, _, y, u = readings(plant, 15, 1, seed=2)
    silent = FusingBank(plant, Extended(), thresholds=(np.inf,) * 5)
    even = replace(silent, beta=(0.2,) * 5)
    uneven = replace(silent, beta=(0.3, 0.1, 0.2, 0.2, 0.2))
    assert uneven.runs_literally and not even.runs_literally
    _, same = run(even, even.init(), t, y[:, 0], u[:, 0])
    _, default = run(silent, silent.init(), t, y[:, 0], u[:, 0])
    np.testing.assert_array_equal(same.estimate, default.estimate)
    _, other = run(uneven, uneven.init(), t, y[:, 0], u[:, 0])
    assert np.all(np.isfinite(other.estimate)) and np.abs(other.estimate - same.estimate).max() > 1e-6


@pytest.mark.parametrize("estimator", [Extended(), Unscented()], ids=["ekf", "ukf"])
@pytest.mark.parametrize("feedback", FEEDBACKS)
def test_each_local_filter_gets_the_share_of_the_mixture_that_the_feedback_states(estimator: Estimator, feedback: str) -> None:
    """Steps 1 to 4 with numpy. Federated P_i = P_m / beta_i, so that their information sums to that of the mixture, and
    Q_i = Q_m / beta_i; as printed P_i = beta_i P_m, with Q reset.
    """
    plant, beta = chain(4), np.array([0.4, 0.1, 0.3, 0.2])
    t, _, y, u = readings(plant, 6, 1, seed=2)
    bank = FusingBank(plant, estimator, beta=tuple(beta), thresholds=(np.inf,) * 4, feedback=feedback)
    state, d = run(bank, bank.init(), t, y[:, 0], u[:, 0], covariance=True)
    f, h = plant.step_jacobian_at(0.0, plant.x0, u[0, 0], plant.dt), plant.output_jacobian_at(0.0, plant.x0, u[0, 0])
    x, P = np.tile(plant.x0, (4, 1)), np.tile(dense(plant.initial_cov), (4, 1, 1))
    Q = np.tile(dense(plant.process_cov), (4, 1, 1))
    for k in range(6):
        if feedback == "federated":  # (sum Q_i^-1)^-1 / beta_i
            Q = np.linalg.inv(np.linalg.inv(Q).sum(axis=0)) / beta[:, None, None]
        x, P = x @ f.T, f @ P @ f.T + Q
        for i in range(4):
            rows = np.arange(4) != i
            K = P[i] @ h[rows].T @ np.linalg.inv(h[rows] @ P[i] @ h[rows].T + np.diag(plant.sensor_cov[rows]))
            x[i], P[i] = x[i] + K @ (y[k, 0] - h @ x[i])[rows], P[i] - K @ h[rows] @ P[i]
        information = np.linalg.inv(P)
        mixed = np.linalg.inv(information.sum(axis=0))
        x = np.tile(mixed @ np.einsum("ijk,ik->j", information, x), (4, 1))
        P = mixed / beta[:, None, None] if feedback == "federated" else mixed * beta[:, None, None]
    # sums of 4 covariances and their inverses, conditioned below 1e3; sigma points of weights up to 1e6 that cancel
    near = 1e-10 if isinstance(estimator, Extended) else 1e-7
    np.testing.assert_allclose(state.memory.P, P, rtol=near, atol=near * np.abs(P).max())
    np.testing.assert_allclose(state.memory.x, x, rtol=near, atol=near * np.abs(x).max())
    assert d.covariance is not None
    np.testing.assert_allclose(d.covariance[-1] / (4 if feedback == "federated" else 1), mixed, rtol=near, atol=near)


@pytest.mark.parametrize("feedback", FEEDBACKS)
def test_the_local_ensembles_get_mean_and_covariance_of_the_mixture(feedback: str) -> None:
    """With square-root updates, of which no draw is in the covariance, and enough members for its rank."""
    plant = chain(4)
    t, _, y, u = readings(plant, 6, 1, seed=2)
    bank = FusingBank(plant, Ensemble(EnKFSettings(size=60, method="square-root")), thresholds=(np.inf,) * 4, feedback=feedback)
    state, d = run(bank, bank.init(), t, y[:, 0], u[:, 0], covariance=True)
    members = state.memory.members
    assert d.covariance is not None
    expected = d.covariance[-1] if feedback == "federated" else d.covariance[-1] / 4  # N P_m or P_m / N
    np.testing.assert_allclose(members.mean(axis=-2), d.estimate[-1], rtol=1e-12)
    np.testing.assert_allclose(np.cov(members.T), expected, rtol=1e-9, atol=1e-12)


def test_federated_with_equal_shares_is_one_filter_with_a_little_more_noise() -> None:
    """x_m and N P_m are those of a Kalman filter with R N / (N - 1): each reading enters N - 1 filters of N."""
    plant = chain(6)
    noisier = replace(plant, sensors=tuple(replace(s, sigma=s.noise_sigma * np.sqrt(6 / 5)) for s in plant.sensors))
    t, _, y, u = readings(plant, 50, 1, seed=4)
    bank, one = FusingBank(plant, Extended(), thresholds=(np.inf,) * 6), CentralFilter(noisier, Extended())
    _, a = run(bank, bank.init(), t, y[:, 0], u[:, 0], covariance=True)
    _, b = run(one, one.init(), t, y[:, 0], u[:, 0], covariance=True)
    assert a.covariance is not None and b.covariance is not None
    # the first covariance is the plant's in each filter: federated it would be N times that, so the two meet as it is forgotten
    np.testing.assert_allclose(a.estimate[30:], b.estimate[30:], atol=1e-9)
    np.testing.assert_allclose(a.covariance[30:], b.covariance[30:], rtol=1e-9)


def test_a_large_bias_is_detected_isolated_and_accommodated() -> None:
    plant = chain(8)
    t, x, y, u = readings(plant, 220, 10, seed=3)
    bank = FusingBank.fit(plant, (t, y, u), estimator=Extended(), false_alarm=1e-2)
    faulty = y.copy()
    faulty[100:140, :, 5] += 15.0
    _, with_fdi = run(bank, bank.init((10,)), t, faulty, u)
    _, without = run(replace(bank, accommodate=False), bank.init((10,)), t, faulty, u)
    assert with_fdi.isolated[100:140, :, 5].mean() > 0.99
    during = slice(100, 140)
    healthy_error = np.sqrt(np.mean((run(bank, bank.init((10,)), t, y, u)[1].estimate - x)[during] ** 2))
    assert np.sqrt(np.mean((with_fdi.estimate - x)[during] ** 2)) < 1.1 * healthy_error
    assert np.sqrt(np.mean((without.estimate - x)[during] ** 2)) > 1.5 * healthy_error
    # the size is seen through the local filter that ignores sensor 5: 15 within the noise of a reading
    assert np.nanmean(with_fdi.fault_size[during, :, 5]) == pytest.approx(15.0, abs=4 / np.sqrt(400) + 0.3)


@pytest.mark.parametrize("literal", [False, True])
def test_two_faults_at_once_are_isolated_where_two_are_allowed(literal: bool) -> None:
    plant = chain(8)
    t, x, y, u = readings(plant, 160, 6, seed=3)
    one = replace(FusingBank.fit(plant, (t, y, u), estimator=Extended(), false_alarm=1e-2), literal=literal)
    two = replace(one, max_faults=2)
    faulty = y.copy()
    faulty[100:140, :, 5] += 15.0
    faulty[100:140, :, 1] -= 12.0
    found = {bank.max_faults: run(bank, bank.init((6,)), t, faulty, u)[1] for bank in (one, two)}
    during = slice(100, 140)
    assert (found[1].isolated.sum(axis=-1) <= 1).all() and (found[2].isolated.sum(axis=-1) <= 2).all()
    assert found[1].isolated[during][..., [1, 5]].all(axis=-1).mean() == 0.0
    assert found[2].isolated[during][..., [1, 5]].all(axis=-1).mean() > 0.95
    error = {k: np.sqrt(np.mean((d.estimate - x)[during] ** 2)) for k, d in found.items()}
    assert error[2] < 0.5 * error[1]
    # without a second fault the third sensors stay in use
    single = run(two, two.init((6,)), t, np.where(np.arange(8) == 1, y, faulty), u)[1]
    assert single.isolated[during][..., 5].mean() > 0.95 and np.delete(single.isolated, 5, axis=-1)[during].mean() < 0.02
    with pytest.raises(ValueError, match="has 8 sensors, give fewer"):
        FusingBank(plant, max_faults=8)


def test_calibration_keeps_the_stated_rate_on_fresh_data() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 400, 25, seed=4)
    bank = FusingBank.fit(plant, (t, y, u), estimator=Extended(), false_alarm=0.02)
    t, _, y, u = readings(plant, 400, 25, seed=5)
    _, decisions = run(bank, bank.init((25,)), t, y, u)
    rate = decisions.alarm.mean()
    # binomial error of calibration and of test add up; samples of a run correlate mildly: a factor of two
    assert rate < 0.02 + 3 * 2 * np.sqrt(2 * 0.02 * 0.98 / 10000)
    with pytest.raises(ValueError, match="give at least"):
        bank.fit_thresholds((t[:10], y[:10], u[:10]), false_alarm=1e-4)


def test_isolation_depends_on_the_units_of_the_states_as_printed_and_not_in_units_of_their_scale() -> None:
    """(20) of Shaheen 2024 is a length in a space of different quantities; a scale for each state makes it dimensionless."""
    plant = chain(6)
    size = np.array([1e3, 1.0, 1.0, 1.0, 1.0, 1.0])  # the first state in thousandths of its unit

    other = changed(
        plant,
        step=lambda t, x, u, dt: plant.step(t, x / size, u, dt) * size,
        output=lambda t, x, u: plant.output(t, x / size, u),
        step_jacobian=None,
        output_jacobian=None,
        x0=plant.x0 * size,
        initial_cov=plant.initial_cov * size**2,
        process_cov=plant.process_cov * size**2,
    )
    t, _, y, u = readings(plant, 40, 5, seed=6)
    y = y.copy()
    y[20:, :, 3] += 15.0
    isolated = {}
    for units, model in (("one", plant), ("other", other)):
        for scale in (None, (1.0,) * 6):
            bank = FusingBank(model, Extended(), thresholds=(1e-3,) * 6, residual_scale=scale, accommodate=False)
            isolated[units, scale is None] = run(bank, bank.init((5,)), t, y, u)[1].isolated[20:]
    np.testing.assert_array_equal(isolated["one", True], isolated["other", True])
    assert isolated["one", True][..., 3].all() and isolated["one", False][..., 3].all()
    assert isolated["other", False][..., 3].mean() < 0.1 and isolated["other", False].any(axis=-1).all()


def test_a_bank_without_thresholds_warns_that_it_never_alarms_unless_set_so() -> None:
    plant = chain(3)
    bank = FusingBank(plant, Extended())
    with pytest.warns(
        UserWarning, match=r"no thresholds and will never raise an alarm; set them with fit_thresholds\(healthy\)"
    ):
        state = bank.init()
    _, d = bank.step(state, 1.0, np.full(3, 1e6), np.zeros(0))  # a step does not repeat it
    assert np.isinf(d.threshold).all() and not d.alarm
    silent = replace(bank, thresholds=(np.inf,) * 3)
    assert not silent.step(silent.init(), 1.0, np.full(3, 1e6), np.zeros(0))[1].alarm


def test_bad_settings_are_rejected() -> None:
    plant = chain(4)
    with pytest.raises(ValueError, match=r"beta has shape \(2,\) with minimum 0.5; expected 4 positive numbers"):
        FusingBank(plant, beta=(0.5, 0.5))
    with pytest.raises(ValueError, match="feedback is 'none'; known: federated, printed"):
        FusingBank(plant, feedback="none")
    with pytest.raises(ValueError, match="covariance of the mixture for equal beta only; give beta=None"):
        FusingBank(plant, Ensemble(), beta=(0.4, 0.1, 0.3, 0.2))
    with pytest.raises(ValueError, match="expected information distribution factors that sum to 1"):
        FusingBank(plant, beta=(0.5, 0.5, 0.5, 0.5))
    with pytest.raises(ValueError, match="leaving one out takes at least 2"):
        FusingBank(chain(1))


@pytest.mark.parametrize("n", [1, 2, 7])
def test_variance_and_distance_are_those_of_the_formulas(n: int) -> None:
    rng = np.random.default_rng(n)
    local, seen = rng.normal(size=(3, 5, n)), rng.normal(size=(3, 5, 5))
    mixed, scale = rng.normal(size=(3, n)), rng.uniform(0.5, 2.0, n)
    variance, distance = disagreement(local, seen, mixed, scale)
    np.testing.assert_allclose(variance, np.var(seen, axis=-2), rtol=1e-13)
    np.testing.assert_allclose(distance, np.linalg.norm((local - mixed[..., None, :]) / scale, axis=-1), rtol=1e-14)


def test_a_run_has_the_bits_that_it_has_alone() -> None:
    rng = np.random.default_rng(0)
    local, seen, mixed = (rng.normal(size=(4, *shape)) for shape in ((5, 9), (5, 5), (9,)))
    together = disagreement(local, seen, mixed, np.ones(9))
    for r in range(4):
        alone = slice(r, r + 1)
        for all_runs, one in zip(together, disagreement(local[alone], seen[alone], mixed[alone], np.ones(9)), strict=True):
            np.testing.assert_array_equal(all_runs[alone], one)
