"""Changes since the start of a run: where it started makes no difference, and slow faults show."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_logs import DT, LOAD, SENSORS, of_factor

from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.learning.checks.detectors import check_detector
from fusion_sfdia.learning.identification.choice import Candidate, ModelChoice
from fusion_sfdia.learning.outlier_detectors.methods import Methods
from fusion_sfdia.learning.outlier_detectors.since_start import SinceStart, changes
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

START = 30


@pytest.fixture(scope="module")
def detector() -> SinceStart:
    logs = [of_factor(seed) for seed in range(4)]
    choice = ModelChoice.of("found", SENSORS, logs, inputs=[LOAD], candidates=[Candidate("factors", 1)])
    found = Methods(choice, SENSORS, [LOAD], 1e-3, START).predictors(logs)
    assert isinstance(found, SinceStart)
    return found


def decisions(detector: SinceStart, log: Log) -> Decision:
    return run(detector, detector.init((), float(log.t[0]) - DT), log)[1]


def test_it_keeps_the_contract(detector: SinceStart) -> None:
    def on(plant: Plant) -> SinceStart:
        return replace(detector, plant=plant, detector=replace(detector.detector, plant=plant))

    check_detector(on, detector.plant)


def test_where_a_run_starts_makes_no_difference(detector: SinceStart) -> None:
    """To rounding: readings of about 10 plus 1000."""
    t, y, u = of_factor(9)
    first, second = decisions(detector, Log(t, y, u)), decisions(detector, Log(t, y + 1000.0, u))
    assert second.residual == pytest.approx(first.residual, abs=1e-10, nan_ok=True)
    assert np.array_equal(first.isolated, second.isolated)
    assert second.reconstruction == pytest.approx(first.reconstruction + 1000.0, abs=1e-10)


def test_nothing_is_tested_at_the_start_and_no_sensor_that_was_not_read_then(detector: SinceStart) -> None:
    t, y, u = of_factor(9)
    y[:START, 2] = np.nan
    y[10] += 50.0
    found = decisions(detector, Log(t, y, u))
    assert not found.alarm[:START].any()
    assert not found.isolated[:, 2].any() and np.isfinite(found.reconstruction).all()


def test_a_drift_is_isolated_that_is_small_in_any_one_sample(detector: SinceStart) -> None:
    """10 units over 200 samples: 0.17 of the noise of a reading in a sample. The limits are those that healthy logs need."""
    scaled = replace(detector, threshold_scale=4.0)
    t, y, u = of_factor(9, 300)
    assert not decisions(scaled, Log(t, y, u)).isolated[:, 3].any()
    y[:, 3] += 10.0 * np.clip((np.arange(300) - 60) / 200, 0, 1)
    found = decisions(scaled, Log(t, y, u))
    assert found.isolated[200:, 3].mean() > 0.9 and not found.isolated[200:, :3].any()


def test_logs_become_changes() -> None:
    t, y, u = of_factor(1, 50)
    y[3, 0], y[:START, 1] = np.nan, np.nan
    (log,) = changes([Log(t, y, u), of_factor(2, START)], START)
    assert log.y[:, 0] == pytest.approx(y[START:, 0] - np.nanmean(y[:START, 0])) and np.isnan(log.y[:, 1]).all()
    assert log.u == pytest.approx(u[START:] - u[:START].mean()) and np.array_equal(log.t, t[START:])


def test_a_detector_of_another_plant_is_refused(detector: SinceStart) -> None:
    with pytest.raises(ValueError, match="BatchDetector of the same plant"):
        replace(detector, plant=replace(detector.plant, name="other"))
