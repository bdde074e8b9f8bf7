"""The outlier detector keeps scikit-learn's contract, and stands in its pipelines and searches."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_up_logs import of_factor
from numpy.typing import NDArray
from sklearn.model_selection import GridSearchCV, TimeSeriesSplit
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import check_estimator

from fusion_sfdia.learning.outlier_detectors.outlier_detector import NOT_APPLICABLE, SensorFaultDetector

QUICK: dict[str, Any] = {"kind": "factors", "order": 1, "folds": 2}
LOAD = 4  # the column of the input
AT = 100  # where the fault begins


def rows(seed: int, steps: int = 240, fault: float = 0.0) -> NDArray[np.float64]:
    """Four sensors and the load; a bias of the second sensor from AT on."""
    _, y, u = of_factor(seed, steps)
    y[AT:, 1] += fault
    return np.hstack([y, u])


@pytest.mark.long
def test_the_checks_of_scikit_learn_pass_but_those_that_permute_samples() -> None:
    """At a rate of 0.1 some rows of the training data are outliers, as a check expects."""
    detector = SensorFaultDetector(kind="autoregression", folds=2, false_alarm=0.1)
    results = check_estimator(detector, expected_failed_checks=NOT_APPLICABLE, on_fail=None, on_skip=None)
    assert not {r["check_name"]: str(r["exception"]) for r in results if r["status"] == "failed"}
    assert {r["check_name"] for r in results if r["status"] == "xfail"} == {*NOT_APPLICABLE}
    assert sum(r["status"] == "passed" for r in results) > 40


@pytest.fixture(scope="module")
def fitted() -> SensorFaultDetector:
    return SensorFaultDetector(inputs=(LOAD,), **QUICK).fit(rows(0, 600))


def test_a_fault_is_an_outlier_of_the_right_sensor(fitted: SensorFaultDetector) -> None:
    found = fitted.predict(rows(1, fault=8.0))
    assert np.mean(found[AT : AT + 40] == -1) > 0.9 and np.mean(found[:AT] == -1) < 0.1
    isolated = fitted.isolated(rows(1, fault=8.0))
    assert isolated.shape == (240, 4) and np.mean(isolated[AT : AT + 40, 1]) > 0.9
    assert not isolated[AT : AT + 40, [0, 2, 3]].any()


def test_scores_and_decisions_belong_together(fitted: SensorFaultDetector) -> None:
    X = rows(1, fault=8.0)
    scores = fitted.score_samples(X)
    assert np.array_equal(fitted.decision_function(X), scores - fitted.offset_)
    assert np.array_equal(fitted.predict(X), np.where(scores < fitted.offset_, -1, 1))
    assert np.array_equal(fitted.sensors_, [0, 1, 2, 3]) and fitted.n_features_in_ == 5


def test_missing_readings_and_columns_that_never_move_are_accepted() -> None:
    X = np.hstack([rows(0, 300), np.ones((300, 1))])
    X[::7, 2] = np.nan
    found = SensorFaultDetector(inputs=(LOAD,), **QUICK).fit(X)
    assert np.array_equal(found.sensors_, [0, 1, 2, 3])
    X[5, LOAD] = np.nan
    assert np.isfinite(found.score_samples(X)).all()


def test_it_stands_in_a_pipeline_and_a_search_over_splits_in_time() -> None:
    detector = make_pipeline(StandardScaler(), SensorFaultDetector(inputs=(LOAD,), **QUICK))

    def quiet(estimator: Any, X: Any, y: Any = None) -> float:
        return float(np.mean(estimator.predict(X) == 1))

    name = "sensorfaultdetector"
    search = GridSearchCV(detector, {f"{name}__order": [1, 2]}, scoring=quiet, cv=TimeSeriesSplit(2), error_score="raise")
    search.fit(rows(0, 240))
    assert set(search.cv_results_["param_sensorfaultdetector__order"]) == {1, 2}
    assert search.best_score_ > 0.7 and search.predict(rows(1)).shape == (240,)


def test_inputs_that_are_no_columns_are_refused() -> None:
    with pytest.raises(ValueError, match=r"inputs has \[7\]"):
        SensorFaultDetector(inputs=(7,)).fit(rows(0))
