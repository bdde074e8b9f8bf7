"""filterpy's filters in the fusing bank: decisions and estimates of ours, to rounding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rounding import rounding
from toy_plants import Array, chain, readings, tanks
from turning_car import car, turning

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.filters.estimators import Estimator, Extended, GaussianState, Unscented, step_stream
from fusion_sfdia.filters.filterpy_estimators import FilterpyExtended, FilterpyUnscented
from fusion_sfdia.filters.gaussian import dense
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.learning.builders import PAPER_FILTERS, as_printed
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.plant.plant import Plant

STEPS, ONSET = 30, 14
WIDE = SigmaPoints(alpha=0.5)
PLANTS = {
    "chain": lambda: chain(4, sensors=7),
    "two-tanks": tanks,
    "marine-engine": lambda: registry.plant("marine-engine"),
    "gas-pipeline": lambda: as_printed(gas_pipeline(nodes=7)),
}
NAMED = {"ekf": FilterpyExtended(), "ukf": FilterpyUnscented(redraw=False)}
PAIRS: dict[str, tuple[Estimator, Estimator]] = {
    "ekf": (Extended(), FilterpyExtended()),
    "ukf": (Unscented(), FilterpyUnscented()),
    "ukf-wide": (Unscented(WIDE), FilterpyUnscented(WIDE)),
    "ukf-printed": (Unscented(redraw=False), FilterpyUnscented(redraw=False)),
    "ukf-printed-wide": (Unscented(WIDE, redraw=False), FilterpyUnscented(WIDE, redraw=False)),
}


def given(plant: Plant) -> tuple[Array, Array, Array]:
    """Two runs: a sensor that fails in the first, one that is missing in both, and a sample without readings in the second."""
    t, _, y, u = readings(plant, STEPS, 2, seed=4)
    y = y.copy()
    y[5:9, :, 2] = np.nan
    y[11, 1] = np.nan
    y[ONSET : ONSET + 8, 0, 1] += 40 * plant.sensor_sigma[1]
    return t, y, u


def tolerance(plant: Plant, estimator: Estimator, found: Decision) -> float:
    """Of what is in units of states and sensors: sums of their largest magnitude, and what cancels in sigma points.

    The weights of sigma points add up to 2 / alpha^2 in magnitude and cancel to 1; the updates solve with S in units of the
    noise, the mixture with covariances in units of the states. A filter forgets: errors of one step add up as long as it runs.
    """
    assert found.covariance is not None
    unit = plant.state_scale
    P = found.covariance / np.outer(unit, unit)
    noise = np.sqrt(plant.sensor_cov)
    H = plant.output_jacobian_at(0.0, plant.x0, plant.input_at(0.0)) / noise[:, None]
    prior = dense(plant.initial_cov)
    solved = np.linalg.cond(H @ prior @ H.T + np.eye(noise.size)) + max(np.linalg.cond(p) for p in P.reshape(-1, *P.shape[-2:]))
    points = 0.0 if not hasattr(estimator, "points") else 2 / estimator.points.alpha**2
    largest = max(np.nanmax(np.abs(found.estimate) / unit), np.nanmax(np.abs(found.reconstruction) / noise))
    return rounding(solved + points, STEPS * (unit.size + noise.size)) * float(largest)


def require_equal(plant: Plant, estimator: Estimator, a: Decision, b: Decision) -> None:
    near = tolerance(plant, estimator, a)
    for name, unit in (
        ("estimate", plant.state_scale),
        ("residual", plant.sensor_sigma),
        ("reconstruction", plant.sensor_sigma),
        ("fault_size", plant.sensor_sigma),
        ("nis", 1.0),
        ("covariance", np.outer(plant.state_scale, plant.state_scale)),
    ):
        one, other = getattr(a, name) / unit, getattr(b, name) / unit
        np.testing.assert_allclose(other, one, rtol=near, atol=near, err_msg=name)
    for name in ("isolated", "guarded", "diverged", "threshold", "alarm"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert not a.diverged.any()


@pytest.mark.parametrize("kind", NAMED)
@pytest.mark.parametrize("name", ["chain", "two-tanks", "gas-pipeline"])
def test_the_bank_decides_and_estimates_as_ours_does_at_the_cost_of_one_filter(name: str, kind: str) -> None:
    """The closed form of N filters against N filters of filterpy, with a fault, missing readings, and a sample of none."""
    plant = PLANTS[name]()
    t, y, u = given(plant)
    quiet = FusingBank(plant, PAPER_FILTERS[kind], thresholds=(np.inf,) * len(plant.sensors))
    _, healthy = run(quiet, quiet.init((2,)), t[:ONSET], y[:ONSET], u[:ONSET])
    reached = np.nanmax(healthy.residual, axis=(0, 1))  # 0 where the input sets what a sensor reads
    levels = np.maximum(1.5 * reached, 1e-3 * plant.sensor_sigma)
    ours = replace(quiet, thresholds=tuple(levels.tolist()))
    theirs = replace(ours, estimator=NAMED[kind], literal=True)
    (_, a), (_, b) = (run(bank, bank.init((2,)), t, y, u, covariance=True) for bank in (ours, theirs))
    require_equal(plant, PAPER_FILTERS[kind], a, b)
    assert a.isolated[ONSET:, 0].any() and not a.isolated[:ONSET].any()


@pytest.mark.parametrize("kind", PAIRS)
@pytest.mark.parametrize("name", PLANTS)
def test_filters_one_by_one_are_ours_one_by_one(name: str, kind: str) -> None:
    plant, (ours, theirs) = PLANTS[name](), PAIRS[kind]
    t, y, u = given(plant)
    bank = FusingBank(plant, ours, thresholds=tuple((3 * plant.sensor_sigma).tolist()), literal=True)
    (_, a), (_, b) = (run(d, d.init((2,)), t, y, u, covariance=True) for d in (bank, replace(bank, estimator=theirs)))
    require_equal(plant, ours, a, b)


@pytest.mark.parametrize("kind", PAIRS)
def test_readings_on_a_circle(kind: str) -> None:
    """A compass whose readings pass north: filterpy's filters see it on the turn of their own prediction."""
    plant, (ours, theirs) = car("modulo in the output"), PAIRS[kind]
    log = turning(seed=7)
    bank = FusingBank(plant, ours, thresholds=(np.inf,) * 4, literal=True)
    (_, a), (_, b) = (
        run(d, d.init(), *(v[:60] for v in log), covariance=True) for d in (bank, replace(bank, estimator=theirs))
    )
    require_equal(plant, ours, a, b)


@pytest.mark.parametrize("kind", PAIRS)
def test_joint_and_update_of_one_filter(kind: str) -> None:
    plant, (ours, theirs) = tanks(), PAIRS[kind]
    u, rng = np.broadcast_to(plant.input_at(0.0), (2, len(plant.inputs))), step_stream(0, 0)
    core = GaussianState(np.stack([plant.x0, 1.01 * plant.x0]), np.stack([(1 + k) * dense(plant.initial_cov) for k in (0, 1)]))
    a, b = (e.predict(plant, core, 0.0, u, plant.dt, rng) for e in (ours, theirs))
    one, other = ours.joint(plant, a, plant.dt, u), theirs.joint(plant, b, plant.dt, u)
    noise, unit = plant.sensor_sigma, plant.state_scale
    points = getattr(ours, "points", WIDE)
    largest = max(np.max(core.x / unit), np.max(one.y / noise))
    near = rounding(2 / points.alpha**2, unit.size + noise.size) * largest
    for got, expected, scale in (
        (other.y, one.y, noise),
        (other.S, one.S, np.outer(noise, noise)),
        (other.C, one.C, np.outer(unit, noise)),
        (other.P, one.P, np.outer(unit, unit)),
    ):
        magnitude = np.max(np.abs(expected / scale))
        np.testing.assert_allclose(got / scale, expected / scale, rtol=0, atol=near * max(1.0, float(magnitude)))
    nothing = np.full((2, noise.size), np.nan)
    for got, expected in zip(theirs.update(plant, b, plant.dt, nothing, u), b.core, strict=True):
        np.testing.assert_array_equal(got, expected)  # without readings the prediction stands


def test_a_run_that_breaks_down_does_not_affect_the_others() -> None:
    plant = chain(4)
    for estimator in NAMED.values():
        P = np.stack([np.eye(4), np.full((4, 4), np.nan), -np.eye(4)])
        prior = estimator.predict(plant, GaussianState(np.zeros((3, 4)), P), 0.0, np.zeros((3, 0)), 1.0, step_stream(0, 0))
        x, p = estimator.update(plant, prior, 1.0, np.ones((3, 4)), np.zeros((3, 0)))
        assert np.isfinite(x[0]).all() and np.isfinite(p[0]).all() and np.isnan(p[1]).all()
        alone = estimator.predict(plant, GaussianState(np.zeros((1, 4)), P[:1]), 0.0, np.zeros((1, 0)), 1.0, step_stream(0, 0))
        np.testing.assert_array_equal(estimator.update(plant, alone, 1.0, np.ones((1, 4)), np.zeros((1, 0))).x[0], x[0])


@pytest.mark.parametrize("kind", NAMED)
def test_the_named_bank_is_ours_with_other_filters(kind: str) -> None:
    plant = tanks()
    ours, theirs = registry.detector(f"fusing-{kind}", plant), registry.detector(f"filterpy-{kind}", plant)
    assert isinstance(ours, FusingBank) and isinstance(theirs, FusingBank)
    assert theirs.runs_literally and theirs.estimator == NAMED[kind]
    assert replace(theirs, estimator=ours.estimator, literal=False) == ours
