"""Thresholds are set on logs that the model has not seen, and other logs are in alarm at about the stated rate."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from made_up_logs import LOAD, SENSORS, STEPS, of_factor

from fusion_sfdia.detectors.batch_detector import BatchDetector
from fusion_sfdia.detectors.data_driven.healthy_limits import without_model
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.learning.identification.choice import Candidate, ModelChoice
from fusion_sfdia.learning.outlier_detectors.calibration import Calibration
from fusion_sfdia.learning.outlier_detectors.methods import Methods
from fusion_sfdia.plant.log import Log

LOGS = [of_factor(seed) for seed in range(6)]
GROUPS = [LOGS[:2], LOGS[2:4], LOGS[4:]]
WARM_UP = 20
FALSE_ALARM = 0.02


@pytest.fixture(scope="module")
def methods() -> Methods:
    choice = ModelChoice.of("found", SENSORS, LOGS, inputs=[LOAD], candidates=[Candidate("factors", 1)])
    return Methods(choice, SENSORS, [LOAD], FALSE_ALARM)


def alarms(detector: Any, log: Log) -> float:
    state, found = detector.init((), -detector.plant.dt), []
    for t, y, u in zip(*log, strict=True):
        state, decision = detector.step(state, float(t), y, u)
        found.append(bool(decision.alarm))
    return float(np.mean(found[WARM_UP:]))


def test_each_group_is_judged_by_a_detector_that_has_not_seen_it(methods: Methods) -> None:
    seen: list[set[int]] = []

    def fit(logs: Sequence[Log]) -> Detector:
        seen.append({k for k, log in enumerate(LOGS) for run in logs if run is log})
        return methods.bank(logs)

    found = Calibration.of(fit, GROUPS, FALSE_ALARM)
    assert seen == [{2, 3, 4, 5}, {0, 1, 4, 5}, {0, 1, 2, 3}, {0, 1, 2, 3, 4, 5}]
    assert found.samples == (2 * (STEPS - WARM_UP),) * 3 and len(found.counted) == 3
    assert isinstance(found.detector, LeaveOneOutBank) and found.detector.threshold_scale > 0
    assert f"of {sum(found.samples)} held-out healthy samples in alarm" in str(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bank", "predictors", "pls", "limits", "dynamic pca", "one-class"])
def test_fresh_logs_are_in_alarm_at_most_three_times_as_often_as_stated(methods: Methods, name: str) -> None:
    found = Calibration.of(methods.fits[name], GROUPS, FALSE_ALARM)
    rate = np.mean([alarms(found.detector, of_factor(seed)) for seed in range(60, 66)])
    assert rate <= 3 * FALSE_ALARM and found.rate == pytest.approx(np.mean(found.counted))


@dataclass(frozen=True)
class Fixed(BatchDetector):
    """The score is the first reading over 1, whatever it was fitted to."""

    def _start(self, batch: tuple[int, ...], seed: int) -> Any:
        return ()

    def _judge(self, memory: Any, now: Any, y: Any, u: Any) -> Any:
        residual = np.where(np.arange(y.shape[-1]) == 0, y, 0.0)
        threshold = np.full(y.shape, self.threshold_scale)
        return (), without_model(self.plant, y, y, residual, threshold, np.abs(residual) > threshold)


def test_the_scale_and_the_rates_are_those_of_the_order_statistics(methods: Methods) -> None:
    """At a rate of 0.1 the 19th of 20 scores and the 10th of the 10 of a group: 10, which one sample of the second group
    exceeds, and 10.5, which none of the first does.
    """

    def log(values: np.ndarray) -> Log:
        y = np.zeros((len(values), 4))
        y[:, 0] = values
        return Log(np.arange(len(values)) * methods.choice.plant.dt, y, np.zeros((len(values), 1)))

    first, second = np.arange(1.0, 11.0), np.arange(1.5, 11.0, 1.0)
    found = Calibration.of(lambda logs: Fixed(methods.choice.plant), [[log(first)], [log(second)]], 0.1, warm_up=0)
    assert found.detector.threshold_scale == pytest.approx(10.0)
    assert found.counted == (0.0, 0.1) and found.rate == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("groups", "rate", "message"),
    [(GROUPS[:1], 0.1, "expected at least two"), (GROUPS, 1e-4, "record more"), (GROUPS, 2.0, "probability")],
)
def test_what_cannot_be_calibrated_is_refused(methods: Methods, groups: Any, rate: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Calibration.of(methods.limits, groups, rate)
