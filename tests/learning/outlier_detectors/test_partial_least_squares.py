"""Leave-one-out predictions by partial least squares, against scikit-learn's own, and the faults that they show."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_up_logs import DT, LOAD, SENSORS, of_factor
from sklearn.cross_decomposition import PLSRegression

from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.learning.checks.detectors import check_detector
from fusion_sfdia.learning.identification.choice import Candidate, ModelChoice
from fusion_sfdia.learning.outlier_detectors.methods import Methods
from fusion_sfdia.learning.outlier_detectors.partial_least_squares import PartialLeastSquares
from fusion_sfdia.learning.outlier_detectors.since_start import SinceStart
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal


def plant_of(*inputs: Signal) -> Plant:
    return linear_plant(
        "readings", np.zeros((1, 1)), np.zeros((4, 1)), [Sensor(s.name, s.name, s.unit, sigma=1.0) for s in SENSORS], dt=DT,
        x0=np.zeros(1), initial_cov=np.ones(1), process_cov=np.ones(1), inputs=inputs,
    )  # fmt: skip


PLANT = plant_of(replace(LOAD, nominal=50.0))
HEALTHY = tuple(of_factor(seed) for seed in range(3))


@cache
def detector() -> PartialLeastSquares:
    return PartialLeastSquares.of_runs(PLANT, HEALTHY, 1e-3)


def decisions(log: Log) -> Decision:
    used = replace(detector(), threshold_scale=2.0)
    return run(used, used.init((), float(log.t[0]) - DT), log)[1]


def test_it_keeps_the_contract_on_changes_since_the_start() -> None:
    choice = ModelChoice.of("found", SENSORS, HEALTHY, inputs=[LOAD], candidates=[Candidate("factors", 1)])
    found = Methods(choice, SENSORS, [LOAD], 1e-3).pls(HEALTHY)
    assert isinstance(found, SinceStart) and found.most_faults == 2
    inner = found.detector
    assert isinstance(inner, PartialLeastSquares)
    check_detector(lambda plant: replace(inner, plant=plant), inner.plant)


def test_predictions_are_those_of_scikit_learn() -> None:
    z = np.concatenate([np.hstack([log.y, log.u]) for log in HEALTHY])
    _, y, u = of_factor(9)
    found = detector()._predicted(y, u)
    for i, k in enumerate(detector().components):
        expected = PLSRegression(k).fit(np.delete(z, i, axis=1), z[:, i]).predict(np.delete(np.hstack([y, u]), i, axis=1))
        assert found[:, i] == pytest.approx(expected.ravel(), abs=1e-9)


def test_more_components_are_taken_where_they_predict_what_was_left_out() -> None:
    """One common cause takes one component, whatever number of sensors shows it; two independent ones take two."""
    rng = np.random.default_rng(3)
    causes, noise = rng.standard_normal((400, 2)), 0.5 * rng.standard_normal((400, 4))
    for shares, least in (([[1, 1, 1, 1], [0, 0, 0, 0]], 1), ([[1, 1, 0.2, 1], [1, -1, 1, 0.3]], 2)):
        log = Log(DT * np.arange(400), causes @ np.array(shares) + noise, np.empty((400, 0)))
        components = PartialLeastSquares.of_runs(plant_of(), [log]).components
        assert min(components) == 1 if least == 1 else max(components) >= 2
    assert set(PartialLeastSquares.of_runs(plant_of(), [log]).weights.diagonal()) == {0.0}


def test_a_step_is_isolated_and_replaced_and_a_healthy_log_is_quiet() -> None:
    t, y, u = of_factor(9)
    healthy = decisions(Log(t, y, u))
    assert healthy.alarm.mean() < 0.05
    wrong = y.copy()
    wrong[80:120, 1] += 15.0
    found = decisions(Log(t, wrong, u))
    assert found.isolated[80:120, 1].all() and found.isolated[80:120].sum(axis=1).max() <= detector().most_faults == 2
    others = np.delete(found.isolated[80:120], 1, axis=1)
    assert others.mean() < 0.05
    error = found.fault_size[80:120, 1] - 15.0
    assert np.abs(error.mean()) < 3.0


def test_a_missing_reading_is_predicted_from_predictions_and_too_few_readings_decide_nothing() -> None:
    t, y, u = of_factor(9)
    gone = y.copy()
    gone[50:60, 2] = np.nan
    gone[70:80, :3] = np.nan
    found = decisions(Log(t, gone, u))
    assert np.isnan(found.residual[50:60, 2]).all() and np.isfinite(found.residual[50:60, [0, 1, 3]]).all()
    assert np.isnan(found.residual[70:80]).all() and np.isfinite(found.reconstruction).all()


def test_too_few_rows_are_refused() -> None:
    t, y, u = of_factor(1)
    y[::2, 1] = np.nan
    with pytest.raises(ValueError, match=r"79 rows with all readings of 5 sensors and inputs .* at least 80 of two"):
        PartialLeastSquares.of_runs(PLANT, [Log(t[:158], y[:158], u[:158])])
    with pytest.raises(ValueError, match=r"weights has shape \(3, 5\); expected \(4, 5\)"):
        replace(detector(), weights=np.zeros((3, 5)))
