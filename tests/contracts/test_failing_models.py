"""A model without finite values is reported as diverged, without numbers or events, and does not affect its batch."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from process_bank import ProcessBank
from toy_plants import Array, chain, readings, tanks

from fusion_sfdia.detectors.detector import Decision, Detector, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.particle_filter import ParticleFilter
from fusion_sfdia.filters.enkf import EnKFSettings
from fusion_sfdia.filters.estimators import Ensemble, Estimator, Extended, GaussianParticles, Unscented
from fusion_sfdia.filters.filterpy_estimators import FilterpyExtended, FilterpyUnscented
from fusion_sfdia.filters.guarded_steps import guarded_points
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.study.trials import decide, faulted, outcome

ROOT = Ensemble(EnKFSettings(size=8, method="square-root"))
PLANT = tanks()
LEVELS = tuple(3e-3 * PLANT.sensor_sigma)  # so low that the banks always have an alarm to suppress
DETECTORS: dict[str, Detector] = {
    "central-ekf": CentralFilter(PLANT),
    "central-ukf": CentralFilter(PLANT, Unscented()),
    "central-enkf": CentralFilter(PLANT, Ensemble()),
    "central-enkf-root": CentralFilter(PLANT, ROOT),
    "loo-ekf": LeaveOneOutBank(PLANT, window=5),
    "loo-ukf": LeaveOneOutBank(PLANT, Unscented(), window=5),
    "fusing-ekf": FusingBank(PLANT, Extended(), thresholds=LEVELS),
    "fusing-ukf": FusingBank(PLANT, Unscented(), thresholds=LEVELS),
    "fusing-ukf-printed": FusingBank(PLANT, thresholds=LEVELS),
    "fusing-enkf": FusingBank(PLANT, Ensemble(), thresholds=LEVELS),
    "fusing-literal-ekf": FusingBank(PLANT, Extended(), thresholds=LEVELS, literal=True),
    "fusing-literal-enkf": FusingBank(PLANT, ROOT, thresholds=LEVELS, literal=True),
    "fusing-filterpy-ekf": FusingBank(PLANT, FilterpyExtended(), thresholds=LEVELS, literal=True),
    "fusing-filterpy-ukf": FusingBank(PLANT, FilterpyUnscented(), thresholds=LEVELS, literal=True),
    "fusing-particles": FusingBank(PLANT, GaussianParticles(50), thresholds=LEVELS, adaptive=True),
    "particles": ParticleFilter(PLANT, size=200),
    "process-bank": ProcessBank(PLANT, window=5, doubt=(2, 9**9), between=(0, 5)),
}
every_detector = pytest.mark.parametrize("detector", DETECTORS.values(), ids=DETECTORS)
NUMBERS = ("estimate", "reconstruction", "residual", "threshold", "fault_size", "nis")
FAILS = 1.9e-3  # m3/s, an inflow within its limits at which the failing models below give no numbers


def failing(detector: Detector, what: str, value: float) -> Detector:
    """The detector with a model whose step or output is `value` for the runs with an inflow of at least FAILS."""

    def broken(t: float, x: Array, u: Array, *dt: float) -> Array:
        inflow = np.where(u >= FAILS, PLANT.input_at(0.0), u)
        return np.where(u[..., :1] >= FAILS, value, getattr(PLANT, what)(t, x, inflow, *dt))

    return replace(detector, plant=replace(PLANT, **{what: broken}))  # type: ignore[type-var]


@every_detector
@pytest.mark.parametrize(("what", "value"), [("step", np.nan), ("step", -np.inf), ("output", np.nan)])
def test_it_is_diverged_from_there_on_and_alone(detector: Detector, what: str, value: float) -> None:
    detector = failing(detector, what, value)
    t, _, y, u = readings(PLANT, 20, 3, seed=1)
    y, u = y.copy(), u.copy()
    y[12:, :, 0] += 20 * PLANT.sensor_sigma[0]
    sound = run(detector, detector.init((3,)), t, y, u)[1]
    u[8:10, 1] = FAILS  # for two steps only: what was lost does not come back
    lost = run(detector, detector.init((3,)), t, y, u, covariance=True)[1]
    assert lost.diverged[8:, 1].all() and not lost.diverged[:8, 1].any() and not lost.diverged[:, [0, 2]].any()
    for name in NUMBERS:
        assert np.isnan(getattr(lost, name)[8:, 1]).all(), name
    assert lost.covariance is not None and np.isnan(lost.covariance[8:, 1]).all()
    assert not lost.isolated[8:, 1].any() and not lost.alarm[8:, 1].any()
    for name in ("process", "suspect"):
        assert (verdict := getattr(lost, name)) is None or (not verdict[8:, 1].any() and verdict[8:, 0].any()), name
    for name in ("process_size", "process_sd", "probability"):
        assert (numbers := getattr(lost, name)) is None or np.isnan(numbers[8:, 1]).all(), name
    assert np.any(lost.isolated[12:, [0, 2]], axis=(0, 2)).all()  # the others have their event
    for f in fields(Decision):
        if f.name != "covariance" and getattr(lost, f.name) is not None:
            np.testing.assert_array_equal(getattr(lost, f.name)[:, [0, 2]], getattr(sound, f.name)[:, [0, 2]], err_msg=f.name)
            np.testing.assert_array_equal(getattr(lost, f.name)[:8], getattr(sound, f.name)[:8], err_msg=f.name)


@every_detector
@pytest.mark.parametrize("what", ["step", "output"])
def test_a_single_run_without_finite_values_diverges_immediately(detector: Detector, what: str) -> None:
    detector = failing(detector, what, np.nan)
    t, _, y, u = readings(PLANT, 4, 1, seed=2)
    _, d = run(detector, detector.init(), t, 2 * y[:, 0], np.full_like(u[:, 0], FAILS))
    assert d.diverged.all() and not d.alarm.any() and np.isnan(d.estimate).all() and np.isnan(d.reconstruction).all()


@pytest.mark.parametrize("count", range(6))
def test_points_without_a_step_go_along_with_the_others(count: int) -> None:
    plant = chain(2)
    u = np.zeros(0)
    broken = replace(plant, step=lambda t, x, u, dt: np.where(np.abs(x[..., :1]) > 9, np.nan, 0.5 * x + 3.0))
    points = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0], [-1.0, 1.0]])
    points[:count, 0] += 10.0
    stepped = guarded_points(broken, 0.0, points, u, 1.0)
    assert stepped.stuck == (count > 0) and not stepped.lost and np.isfinite(stepped.ahead).all()
    np.testing.assert_array_equal(stepped.ahead[count:], 0.5 * points[count:] + 3.0)
    if 0 < count < 5:  # stuck points move with the others, to the rounding of a mean
        drift = np.mean(0.5 * points[count:] + 3.0 - points[count:], axis=0)
        np.testing.assert_allclose(stepped.ahead[:count], points[:count] + drift, rtol=1e-14)


@pytest.mark.parametrize(
    "estimator", [Unscented(SigmaPoints(alpha=1.0)), Unscented(), Ensemble()], ids=["ukf", "ukf-narrow", "enkf"]
)
def test_a_stuck_point_is_reported_as_guarded_and_does_not_spoil_the_estimate(estimator: Estimator) -> None:
    plant = chain(6)
    worst: list[float] = []

    def one_lost(t: float, x: Array, u: Array, dt: float) -> Array:
        """Without a number for the point that reaches furthest."""
        ahead = plant.step(t, x, u, dt)
        worst.append(float(x[..., 0].max()))
        return np.where(x[..., :1] == worst[-1], np.nan, ahead)

    broken = replace(plant, step=one_lost)
    t, x, y, u = readings(plant, 60, 1, seed=3)
    _, d = run(CentralFilter(broken, estimator), CentralFilter(broken, estimator).init(), t, y[:, 0], u[:, 0])
    _, sound = run(CentralFilter(plant, estimator), CentralFilter(plant, estimator).init(), t, y[:, 0], u[:, 0])
    assert worst and d.guarded.all() and not d.diverged.any() and not sound.guarded.any()
    # one of 13 sigma points, or of 40 members, moves by the mean of the others: less than twice the error of all of them
    assert np.sqrt(np.mean((d.estimate - x[:, 0]) ** 2)) < 2 * np.sqrt(np.mean((sound.estimate - x[:, 0]) ** 2))


@every_detector
def test_a_state_moved_into_its_limits_is_guarded_as_ever(detector: Detector) -> None:
    t, _, y, u = readings(PLANT, 12, 2, seed=4)
    u = u.copy()
    u[5, 1] = 0.05  # m3/s: the upper tank is 5 m higher after a step, beyond its 3 m
    free = replace(PLANT, inputs=(Signal("inflow", "m3/s", PLANT.inputs[0].nominal),))  # else the input would be absurd
    detector = replace(detector, plant=free)  # type: ignore[type-var]
    _, d = run(detector, detector.init((2,)), t, y, u)
    assert d.guarded[6, 1] and not d.guarded[:, 0].any() and not d.diverged.any() and np.isfinite(d.estimate).all()


def test_a_campaign_and_a_calibration_go_on() -> None:
    plant = chain(4)
    data = faulted(plant, 80, range(4), "strong-bias", None)

    def step(t: float, x: Array, u: Array, dt: float) -> Array:
        lost = (t > 25.0) & (np.arange(x.shape[0]) == 2).reshape(-1, *(1,) * (x.ndim - 1))
        return np.where(lost, np.nan, plant.step(t, x, u, dt))

    y = data.y.copy()
    detectors = CentralFilter(replace(plant, step=step)), CentralFilter(plant)
    broken, usual = (
        outcome(plant, each, decide(of, each)) for of, each in zip(detectors, (replace(data, y=y), data), strict=True)
    )
    assert broken["diverged"].tolist() == [False, False, True, False]
    others = [0, 1, 3]
    for name in ("score", "alarm", "square_error"):
        np.testing.assert_array_equal(broken[name][:, others], usual[name][:, others])

    t, _, healthy, u = readings(PLANT, 60, 5, seed=5)
    bank = FusingBank(PLANT, Extended())
    u = u.copy()
    thresholds = bank.fit_thresholds((t, healthy[:, :4], u[:, :4]), false_alarm=0.1).thresholds
    u[30, 4] = FAILS
    lossy = failing(bank, "step", np.nan)
    assert isinstance(lossy, FusingBank) and lossy.fit_thresholds((t, healthy, u), false_alarm=0.1).thresholds == thresholds


def test_the_gas_pipeline_is_a_plant_too() -> None:
    from fusion_sfdia.diagnosis.simulate import simulate
    from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline

    usual: Plant = gas_pipeline()

    def step(t: float, x: Array, u: Array, dt: float) -> Array:
        return np.where(u[..., :1] < 2e6, np.nan, usual.step(t, x, u, dt))

    plant = replace(usual, step=step)
    recording = simulate(usual, 6, [0, 1])
    u = recording.u_of_runs.copy()
    u[3:, 1, 0] = 1.5e6  # Pa, within its limits
    beyond = u.copy()
    beyond[3:, 1, 0] = -1e9  # Pa, beyond physics: the usual input replaces it
    for detector in (LeaveOneOutBank(plant), CentralFilter(plant, Ensemble())):
        _, d = run(detector, detector.init((2,)), recording.t, recording.y, u)
        assert d.diverged[3:, 1].all() and not d.diverged[:, 0].any() and np.isfinite(d.estimate[:, 0]).all()
        _, d = run(detector, detector.init((2,)), recording.t, recording.y, beyond)
        assert not d.diverged.any() and d.absurd_input[3:, 1, 0].all() and d.absurd_input.sum() == 3


@pytest.mark.parametrize("estimator", [Extended(), Unscented(), Ensemble()], ids=["ekf", "ukf", "enkf"])
def test_an_estimate_pulled_out_of_the_model_is_guarded_and_comes_back(estimator: Estimator) -> None:
    """The model has no number for a first state above 5: a faulty reading pulls the estimate there for a while."""
    plant = chain(4)

    def step(t: float, x: Array, u: Array, dt: float) -> Array:
        return np.where(x[..., :1] > 5.0, np.nan, plant.step(t, x, u, dt))

    t, x, y, u = readings(plant, 160, 2, seed=6)
    assert np.abs(x).max() < 4.0  # the truth stays within
    y = y.copy()
    y[20:25, 1] = 200.0  # not so far that the readings are not taken
    detector = CentralFilter(replace(plant, step=step), estimator)
    _, d = run(detector, detector.init((2,)), t, y, u)
    assert d.guarded[21:25, 1].all() and not d.guarded[:, 0].any() and not d.diverged.any()
    assert not d.guarded[120:, 1].any() and np.abs(d.estimate[120:, 1] - x[120:, 1]).max() < 4.0
