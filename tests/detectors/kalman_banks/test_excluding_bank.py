"""The end of a step of a bank that excludes sensors: each field of its Decision from literal arrays, and its settings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from toy_plants import chain, changed

from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.exclusion import Exclusion, none_excluded
from fusion_sfdia.detectors.kalman_banks.excluding_bank import ExclusionUpdate, SensorTests
from fusion_sfdia.detectors.kalman_banks.leave_one_out import statistics
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.state import as_batch, as_single
from fusion_sfdia.filters import ekf
from fusion_sfdia.filters.estimators import Prior, Unscented
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
PLANT = chain(3, sensors=5)
N, LIMIT, FALSE_ALARM = 5, 9.0, 0.02
H = PLANT.output_jacobian_at(0.0, PLANT.x0, np.zeros(0))
X, P = np.array([1.0, 2.0, 3.0]), np.diag([0.5, 1.0, 2.0])
EXPECTED = H @ X
VARIANCE = np.diag(H @ P @ H.T) + PLANT.sensor_cov
READINGS = EXPECTED + np.array([0.1, 2.0, 40.0, 0.3, np.nan])
ISOLATED = np.array([False, False, True, False, False])
NOTHING = np.zeros(N, bool)
TESTED = SensorTests(
    usable=np.array([True, False, True, True, False]), isolated=ISOLATED, residual=np.arange(10.0, 15.0),
    threshold=np.arange(20.0, 25.0), size=np.arange(30.0, 35.0), capped=np.array(True), limit=LIMIT,
)  # fmt: skip


def conclude(
    exclusion: Exclusion, y: Array = READINGS, tested: SensorTests = TESTED, p: Array = P, lost: bool = False, **settings: Any
) -> Any:
    return conclusion(LeaveOneOutBank(PLANT, false_alarm=FALSE_ALARM, **settings), exclusion, y, tested, p, lost)


def conclusion(
    bank: LeaveOneOutBank,
    exclusion: Exclusion,
    y: Array = READINGS,
    tested: SensorTests = TESTED,
    p: Array = P,
    lost: bool = False,
) -> tuple[Exclusion, Decision]:
    """The exclusions and the Decision of the only run of a batch."""
    joint = ekf.joint(X[None], p[None], lambda s: s @ H.T, H, PLANT.sensor_cov)
    prior = Prior((), np.array([True]), np.array([lost]))
    update = ExclusionUpdate(X[None], p[None], prior, joint, statistics(joint, y[None], tested.usable[None]))
    of_run = SensorTests(*(a[None] for a in tested[:-1]), tested.limit)
    now = TimeStep(0.0, 1.0, 1.0, 0, 1)
    after, decision = bank._conclude(now, y[None], np.zeros((1, 0)), as_batch(exclusion), update, of_run)
    return as_single(after), Decision(**{name: a[0, ...] for name, a in vars(decision).items() if np.ndim(a)})


def out(*sensors: int, size: float = 5.0, evidence: float = 0.0, quiet: float = 0.0) -> Exclusion:
    held = np.isin(np.arange(N), sensors)
    return Exclusion(held, *(np.where(held, value, 0.0) for value in (size, 1.0, evidence, quiet)))


def test_excluded_sensors_are_replaced_and_compared_with_their_expected_readings() -> None:
    """Sensors 1 and 4 are out, 4 is missing; 2 is isolated now, with its error as the first estimate of its fault."""
    after, decision = conclude(out(1, 4, size=-100.0))
    assert after.out.tolist() == decision.isolated.tolist() == [False, True, True, False, True]
    assert after.size[2] == pytest.approx(40.0) and after.samples[2] == 1
    np.testing.assert_allclose(decision.fault_size, [np.nan, -100.0, 40.0, np.nan, -100.0])
    np.testing.assert_array_equal(decision.reconstruction, np.where([1, 0, 0, 1, 0], READINGS, EXPECTED))
    np.testing.assert_allclose(decision.residual, [10.0, 2.0, 12.0, 13.0, np.nan])
    np.testing.assert_allclose(decision.threshold, [20.0, 3 * np.sqrt(VARIANCE[1]), 22.0, 23.0, 24.0])
    assert decision.guarded and decision.capped and not decision.diverged
    np.testing.assert_array_equal(decision.estimate, X)
    np.testing.assert_array_equal(decision.covariance, P)


def test_without_accommodation_sensors_are_isolated_and_nothing_is_left_out() -> None:
    before = none_excluded((), N)
    after, decision = conclude(before, accommodate=False)
    for now, then in zip(after, before, strict=True):
        np.testing.assert_array_equal(now, then)
    np.testing.assert_array_equal(decision.isolated, ISOLATED)
    np.testing.assert_array_equal(decision.fault_size, np.where(ISOLATED, TESTED.size, np.nan))


@pytest.mark.parametrize(("evidence", "back"), [(4.9, False), (5.1, True)])
def test_a_sensor_is_readmitted_at_odds_of_its_share_of_the_false_alarms(evidence: float, back: bool) -> None:
    """ln(5 / 0.02) = 5.52; an error of 0 against a fault of one standard deviation adds 1 / 2."""
    y, healthy = EXPECTED.copy(), TESTED._replace(isolated=NOTHING)
    after, decision = conclude(out(1, size=0.0, evidence=evidence, quiet=1.0), y, healthy)
    assert after.out[1] == decision.isolated[1] == (not back)


def test_a_reading_beyond_the_limit_voids_the_evidence_of_health() -> None:
    y = EXPECTED.copy()
    y[1] += 3.1 * np.sqrt(VARIANCE[1])
    after, _ = conclude(out(1, size=20.0, evidence=100.0, quiet=1.0), y, TESTED._replace(isolated=NOTHING))
    assert after.out[1] and after.evidence[1] == 0.0


def test_a_filter_without_a_step_or_with_a_negative_variance_has_diverged() -> None:
    for p, lost, expected in ((P, True, True), (np.diag([0.5, -1.0, 2.0]) / 1e3, False, True), (P, False, False)):
        _, decision = conclude(none_excluded((), N), p=p, lost=lost)
        assert bool(decision.diverged) is expected


def test_settings() -> None:
    assert LeaveOneOutBank(PLANT).most_faults == 2  # of five sensors
    assert LeaveOneOutBank(PLANT, max_faults=1).most_faults == 1
    for settings, message in (
        ({"max_faults": 5}, "max_faults is 5; plant 'chain' has 5 sensors"),
        ({"false_alarm": 1.0}, "false_alarm is 1.0"),
        ({"estimator": Unscented(redraw=False)}, "redraw"),
    ):
        with pytest.raises(ValueError, match=message):
            LeaveOneOutBank(PLANT, **settings)


@dataclass(frozen=True)
class OnAnother(LeaveOneOutBank):
    """A bank whose filter estimates the state of another plant: the same readings plus 5 of each sensor."""

    @property
    def model(self) -> Plant:
        return changed(self.plant, output=partial(shifted_readings, self.plant))


def shifted_readings(plant: Plant, t: float, x: Array, u: Array) -> Array:
    return np.asarray(plant.output(t, x, u) + 5.0)


def test_expected_readings_are_those_of_the_model_that_the_filter_estimates() -> None:
    """By default the plant; a bank on an augmented plant states that one."""
    assert LeaveOneOutBank(PLANT).model is PLANT
    usual, other = (conclusion(bank, out(1))[1] for bank in (LeaveOneOutBank(PLANT), OnAnother(PLANT)))
    held = usual.isolated | np.isnan(READINGS)
    np.testing.assert_allclose(other.reconstruction[held], usual.reconstruction[held] + 5.0, rtol=1e-15)
    assert other.residual[1] == usual.residual[1] - 5.0  # of the sensor that is out
