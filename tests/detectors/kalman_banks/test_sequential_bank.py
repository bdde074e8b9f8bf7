"""Sequential tests on innovations and leave-one-out innovations of one filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.sequential_bank import SequentialBank
from fusion_sfdia.detectors.kalman_banks.sequential_rules import Cusum, Ewma, SequentialRule, Shewhart, SumOfSquares
from fusion_sfdia.filters.estimators import Ensemble, Unscented

MEMORIES: list[SequentialRule] = [SumOfSquares(15), Cusum(1.0), Ewma(0.2)]


@pytest.mark.parametrize("leave_one_out", [False, True])
def test_without_memory_and_accommodation_it_is_the_one_sample_test(leave_one_out: bool) -> None:
    plant = chain(6, sensors=5)
    t, _, y, u = readings(plant, 60, 4, seed=0)
    y = y.copy()
    y[30:40, :, 2] += 12 * plant.sensor_sigma[2]
    y[5, 0, 1] = np.nan
    mine = SequentialBank(plant, leave_one_out=leave_one_out, max_faults=1, accommodate=False)
    other = LeaveOneOutBank(plant, window=1, max_faults=1, accommodate=False) if leave_one_out else CentralFilter(plant)
    _, a = run(mine, mine.init((4,)), t, y, u)
    _, b = run(other, other.init((4,)), t, y, u)
    np.testing.assert_array_equal(a.isolated, b.isolated)
    np.testing.assert_array_equal(a.estimate, b.estimate)
    # residual and threshold are multiplied and divided by each other: some roundings
    np.testing.assert_allclose(a.scores, b.scores, rtol=1e-13)
    np.testing.assert_allclose(a.residual, b.residual, rtol=1e-12)


@pytest.mark.parametrize("leave_one_out", [False, True])
@pytest.mark.parametrize("rule", [SumOfSquares(15), Ewma(0.2)], ids=["window", "ewma"])
def test_the_false_alarm_rate_of_a_sensor_is_its_share(rule: SequentialRule, leave_one_out: bool) -> None:
    """On a linear Gaussian plant, of each sensor by itself: exactly, as innovations are white and Gaussian there."""
    plant, share, runs = chain(4), 0.02, 400
    t, _, y, u = readings(plant, 120, runs, seed=1)
    bank = SequentialBank(plant, (rule,), leave_one_out, false_alarm=4 * share, accommodate=False)
    _, d = run(bank, bank.init((runs,)), t, y, u)
    over = d.scores > 1
    of_runs = over.mean(axis=0)  # neighbouring samples correlate, runs do not
    error = of_runs.std(axis=0) / np.sqrt(runs)
    assert np.all(np.abs(of_runs.mean(axis=0) - share) < 4 * error)


@pytest.mark.parametrize("leave_one_out", [False, True])
@pytest.mark.parametrize("rule", MEMORIES, ids=lambda rule: type(rule).__name__)
def test_alarms_begin_at_most_at_the_stated_rate(rule: SequentialRule, leave_one_out: bool) -> None:
    plant = chain(6)
    t, _, y, u = readings(plant, 300, 60, seed=2)
    bank = SequentialBank(plant, (Shewhart(), rule), leave_one_out, false_alarm=0.01)
    _, d = run(bank, bank.init((60,)), t, y, u)
    begins = d.isolated[1:] & ~d.isolated[:-1]
    # the limit of a cumulative sum is an approximation: a tolerance of a tenth
    assert begins.sum() <= binom.ppf(0.9999, len(t) * 60, 0.011)


@pytest.mark.parametrize("plant", [chain(12), tanks()], ids=["chain", "tanks"])
@pytest.mark.parametrize("rule", MEMORIES, ids=lambda rule: type(rule).__name__)
def test_memory_detects_the_weak_bias_that_one_sample_misses(rule: SequentialRule, plant) -> None:  # type: ignore[no-untyped-def]
    t, _, y, u = readings(plant, 120, 40, seed=3)
    y = y.copy()
    y[60:, :, 1] += 3.0 * plant.sensor_sigma[1]
    recall = []
    for rules in ((Shewhart(),), (Shewhart(), rule)):
        bank = SequentialBank(plant, rules)
        _, d = run(bank, bank.init((40,)), t, y, u)
        recall.append(d.isolated[60:, :, 1].mean())
        assert np.delete(d.isolated, 1, axis=-1).mean() < 0.01
    assert recall[1] > 0.7 and recall[1] > recall[0] + 0.1


def test_simultaneous_faults_are_isolated_at_once_by_leave_one_out_and_one_per_step_by_innovations() -> None:
    plant = chain(12)
    t, _, y, u = readings(plant, 60, 20, seed=4)
    y = y.copy()
    y[40:, :, [2, 7]] += 15.0
    for leave_one_out, named in ((True, [2, 2]), (False, [1, 2])):
        bank = SequentialBank(plant, (Shewhart(), Cusum()), leave_one_out)
        _, d = run(bank, bank.init((20,)), t, y, u)
        assert [np.median(d.isolated[k].sum(axis=-1)) for k in (40, 41)] == named
        assert np.all(d.isolated[42:, :, [2, 7]])


def test_an_isolated_sensor_is_left_out_replaced_and_readmitted() -> None:
    plant = chain(12)
    t, _, y, u = readings(plant, 160, 30, seed=5)
    faulty = y.copy()
    faulty[60:90, :, 4] += 8.0
    bank = SequentialBank(plant, (Shewhart(), Ewma()))
    _, clean = run(bank, bank.init((30,)), t, y, u)
    _, d = run(bank, bank.init((30,)), t, faulty, u)
    assert d.isolated[65:90, :, 4].all() and not d.isolated[100:, :, 4].any()
    assert abs(d.fault_size[75:90, :, 4].mean() - 8.0) < 4 * d.fault_size[75:90, :, 4].mean(axis=0).std() / np.sqrt(30)
    off = np.mean((d.reconstruction - clean.estimate)[65:90, :, 4])
    assert abs(off) < 1.0  # of a bias of 8


def test_invalid_settings_are_rejected() -> None:
    plant = chain(4)
    for estimator in (Ensemble(), Unscented(redraw=False)):
        with pytest.raises(ValueError, match="no consistent mean"):
            SequentialBank(plant, estimator=estimator)
    with pytest.raises(ValueError, match="max_faults is 4"):
        SequentialBank(plant, max_faults=4)
    for rules in ((), Cusum()):
        with pytest.raises(ValueError, match="expected a tuple"):
            SequentialBank(plant, rules)  # type: ignore[arg-type]


def test_a_bank_reports_when_no_more_sensors_may_be_left_out() -> None:
    plant = chain(12)
    t, _, y, u = readings(plant, 60, 10, seed=6)
    y = y.copy()
    y[40:, :, [2, 7]] += 15.0
    for most in (1, 2):
        bank = SequentialBank(plant, (Shewhart(), Ewma()), max_faults=most)
        _, d = run(bank, bank.init((10,)), t, y, u)
        assert np.all(d.isolated[42:].sum(axis=-1) == most)
        assert d.capped[42:50].all() == (most == 1) and not d.capped[:40].any()
    assert SequentialBank(plant).most_faults == LeaveOneOutBank(plant).most_faults
