"""The decision between sensor and process, on evidence made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joints import random_joint
from numpy.typing import NDArray
from rounding import rounding
from toy_plants import chain

from fusion_sfdia.detectors.kalman_banks.competition import (
    ABSORBED,
    LEAST_WEIGHT,
    PRIOR,
    ChiSquareLimits,
    Evidence,
    Present,
    absorbed_before,
    accepted,
    alternatives,
    eliminated,
    gathered,
    led_by,
    one_sample_evidence,
    suspects,
)
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, statistics
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Best

Array = NDArray[Any]
NOTHING = -np.inf
LIMITS = ChiSquareLimits(
    one=12.0, window=15.0, process=20.0, sensor_margin=np.array(3.0), process_margin=10.0, smallest=np.array(0.5)
)


def evidence(sensor: Any, process: Any, one_sample: Any = None, statistic: float = 100.0) -> Evidence:
    """Evidence of sensors and process hypotheses, all with that statistic, the sizes 1, 2 .."""
    s, p = np.asarray(sensor, dtype=float), np.asarray(process, dtype=float)
    one = np.full(s.shape, NOTHING) if one_sample is None else np.asarray(one_sample, dtype=float)
    far_s, far_p = np.zeros(s.shape, bool), np.zeros(p.shape, bool)
    level = np.ones((*s.shape[:-1], s.shape[-1] + p.shape[-1]))
    return Evidence(
        level, far_s, np.full(s.shape, statistic), np.ones(s.shape), np.ones(s.shape), s, one,
        far_p, np.full(p.shape, statistic), np.ones(p.shape), np.ones(p.shape), p,
    )  # fmt: skip


def best(statistic: Any) -> Best:
    """Best onsets with that statistic; sizes, information and evidence tell where they came from."""
    s = np.asarray(statistic, dtype=float)
    return Best(s, s + 0.1, s + 0.2, s + 0.3, np.zeros(s.shape, int))


@pytest.mark.parametrize(
    ("sensors", "process", "is_sensor", "is_process"),
    [
        ([30.0, 1.0], [26.9, 0.0], True, False),  # 3 ahead
        ([30.0, 1.0], [27.1, 0.0], False, False),  # too close
        ([0.0, 16.0], [26.1, 1.0], False, True),  # 10 ahead
        ([0.0, 16.0], [25.9, 1.0], False, False),
        ([30.0, 29.0], [NOTHING, NOTHING], True, False),  # another sensor is no rival
        ([1.0, 2.0], [30.0, 29.5], False, True),  # nor another difference of the process
    ],
)
def test_a_cause_is_accepted_by_its_lead_over_the_other_kind(
    sensors: list[float], process: list[float], is_sensor: bool, is_process: bool
) -> None:
    found = accepted(evidence(sensors, process), LIMITS, np.array(True))
    assert (bool(found.is_sensor), bool(found.is_process)) == (is_sensor, is_process)
    assert found.sensor == np.argmax(sensors) and found.process == np.argmax(process)
    elsewhere = accepted(evidence(sensors, process), LIMITS, np.array(False))
    assert not elsewhere.is_sensor and not elsewhere.is_process


def test_a_cause_needs_a_statistic_above_its_own_limit() -> None:
    for statistic, sensor, process in ((14.9, False, False), (15.1, True, False), (19.9, True, False), (20.1, True, True)):
        assert accepted(evidence([50.0], [0.0], statistic=statistic), LIMITS, np.array(True)).is_sensor == sensor
        assert accepted(evidence([0.0], [50.0], statistic=statistic), LIMITS, np.array(True)).is_process == process


def test_the_process_competes_with_the_present_sample_too() -> None:
    """And a sensor with the margin of its run."""
    both = evidence([[1.0, 2.0]] * 2, [[30.0], [18.0]], one_sample=[[25.0, NOTHING], [NOTHING, 5.0]])
    np.testing.assert_array_equal(both.of_sensors, [[25.0, 2.0], [1.0, 5.0]])
    assert accepted(both, LIMITS, np.ones(2, bool)).is_process.tolist() == [False, True]
    margins = LIMITS._replace(sensor_margin=np.array([3.0, 10.0]))
    runs = evidence([[25.0], [25.0]], [[18.0], [18.0]])
    assert accepted(runs, margins, np.ones(2, bool)).is_sensor.tolist() == [True, False]


def test_suspects_are_those_within_the_margin_of_the_best() -> None:
    now = evidence([20.0, 12.0, 9.0], [18.0, 5.0], one_sample=[NOTHING, NOTHING, 10.5])
    np.testing.assert_array_equal(suspects(now, np.array(True), 10.0), [True, True, True, True, False])
    np.testing.assert_array_equal(suspects(now, np.array(True), 4.0), [True, False, False, True, False])
    assert not suspects(now, np.array(False), 10.0).any()


def test_sizes_that_a_model_may_err_by_are_not_accepted() -> None:
    """The second sensor and the first process hypothesis are of the smallest size that is."""
    limits = LIMITS._replace(smallest=np.array([1.1, 1.0, 1.0, 1.1]))
    for sensors, process, expected in (
        ([50.0, 0.0], [0.0, 0.0], (False, False)), ([0.0, 50.0], [0.0, 0.0], (True, False)),
        ([0.0, 0.0], [50.0, 0.0], (False, True)), ([0.0, 0.0], [0.0, 50.0], (False, False)),
    ):  # fmt: skip
        now = evidence(sensors, process)
        found = accepted(now._replace(level=-now.level), limits, np.array(True))  # of either sign
        assert (found.is_sensor, found.is_process) == expected


def test_probabilities_are_those_of_bayes_rule_for_at_most_one_cause() -> None:
    sensors, process = np.array([4.0, -3.0]), np.array([8.0])
    weights = PRIOR * np.exp(np.concatenate([sensors, process]) / 2)
    found = evidence(sensors, process).probability
    np.testing.assert_allclose(found, weights / (1 + weights.sum()), rtol=rounding(1.0, 20))


def test_before_any_reading_each_cause_is_true_once_in_a_thousand() -> None:
    """Without evidence a thousandth for each, against nothing; a likelihood ratio of a thousand makes the odds even."""
    prior = evidence([0.0, 0.0], [0.0]).probability
    np.testing.assert_allclose(prior, 1e-3 / (1 + 3e-3), rtol=rounding(1.0, 20))
    even = evidence([2 * np.log(1e3), NOTHING], [NOTHING]).probability
    np.testing.assert_allclose(even, [0.5, 0.0, 0.0], rtol=rounding(1.0, 20))


@pytest.mark.parametrize("level", [NOTHING, -50.0, 0.0, 30.0, 5000.0])
def test_probabilities_add_up_to_at_most_one(level: float) -> None:
    rng = np.random.default_rng(0)
    found = evidence(level + rng.normal(size=(50, 4)), level + rng.normal(size=(50, 3))).probability
    assert found.shape == (50, 7) and np.all(np.isfinite(found)) and np.all(found >= 0)
    assert np.all(found.sum(axis=-1) <= 1 + rounding(1.0, 8))
    if level == NOTHING:
        assert not found.any()


def test_the_window_with_more_evidence_explains_a_hypothesis() -> None:
    """Two sensors, one augmented state, one equation, which the slow window does not have."""
    recent, slow = best([[10.0, 20.0, 30.0, 40.0]]), best([[15.0, 5.0, 35.0]])
    found = gathered(recent, slow, np.array([[7.0]]), np.array([[1.0, 2.0]]), np.array([0.5, 6.0]))
    np.testing.assert_allclose(
        found.level, [[7 * 15.1 * 2 / 3, 20.1, 7 * 35.1 * 2 / 3, 40.1]], rtol=1e-15
    )  # slopes over 7 samples
    np.testing.assert_array_equal(found.slow_sensor, [[True, False]])
    np.testing.assert_array_equal(found.slow_process, [[True]])
    np.testing.assert_array_equal(found.statistic_s, [[15, 20]])
    np.testing.assert_array_equal(found.statistic_p, [[35, 40]])
    np.testing.assert_array_equal(found.size_s, [[15.1, 20.1]])
    np.testing.assert_array_equal(found.information_p, [[35.2, 40.2]])
    np.testing.assert_allclose(found.sensor, [[15.3, 20.3]], rtol=1e-15)
    np.testing.assert_allclose(found.process, [[35.3 - 0.5, 40.3 - 6.0]], rtol=1e-15)  # less the handicap, evidence only
    np.testing.assert_array_equal(found.one_sample, [[1, 2]])
    assert found.best_process[0] == pytest.approx(34.8)
    np.testing.assert_array_equal(recent.evidence, best([[10.0, 20.0, 30.0, 40.0]]).evidence)  # not changed in place


def sampled(seed: int = 0, runs: int = 200) -> tuple[LeaveOneOut, Array, Array]:
    """Leave-one-out statistics of readings of which some have large faults; S and the prediction."""
    rng = np.random.default_rng(seed)
    joint, _ = random_joint(rng, 4, 6, batch=(runs,))
    y = joint.y + rng.normal(size=(runs, 6)) + 12.0 * (rng.random((runs, 6)) < 0.2) * rng.normal(size=(runs, 6))
    return statistics(joint, y, rng.random((runs, 6)) < 0.95), joint.S, y


def without_process(found: LeaveOneOut, sizes: Array) -> tuple[Evidence, Present]:
    """The evidence of the present sample against no process hypothesis."""
    runs = found.used.shape[:-1]
    one = one_sample_evidence(found, sizes)
    return evidence(np.full(one.shape, NOTHING), np.zeros((*runs, 0)), one), Present(
        np.zeros((*runs, 6, 0)), sizes, np.zeros((*runs, 0))
    )


@pytest.mark.parametrize("most", [1, 2, 3])
def test_without_rivals_the_present_sample_is_that_of_the_leave_one_out_bank(most: int) -> None:
    found, _, _ = sampled()
    bank = LeaveOneOutBank(chain(6), window=1, false_alarm=1e-3, max_faults=most)
    ours, present = without_process(found, np.full(6, 20.0))
    limits = LIMITS._replace(one=bank.limits[0])
    isolated, capped = eliminated(found, ours, present, limits, np.full(200, most))
    _, which, above = bank._eliminate(found, np.zeros((200, 6), bool))
    np.testing.assert_array_equal(isolated, which)
    np.testing.assert_array_equal(capped, above)
    assert which.sum(axis=-1).max() == most and (which.sum(axis=-1) == 0).any() and (above.any() or most == 3)


def test_sensors_that_are_out_already_take_from_the_room() -> None:
    found, _, _ = sampled()
    ours, present = without_process(found, np.full(6, 20.0))
    isolated, capped = eliminated(found, ours, present, LIMITS, np.zeros(200, int))
    assert not isolated.any()
    np.testing.assert_array_equal(capped, found.chi_square.max(axis=-1) > LIMITS.one)


def test_a_process_hypothesis_that_explains_the_sample_as_well_keeps_the_sensors() -> None:
    """The first sensor competes with all evidence of the process, whatever its onset."""
    found, _, _ = sampled()
    ours, present = without_process(found, np.full(6, 20.0))
    lead = np.max(ours.one_sample, axis=-1)
    alone = eliminated(found, ours, present, LIMITS, np.full(200, 1))[0].any(axis=-1)
    worst = np.argmax(found.chi_square, axis=-1)
    lead = np.take_along_axis(ours.one_sample, worst[:, None], axis=-1)[:, 0]
    for behind, expected in ((2.9, np.zeros(200, bool)), (3.1, alone)):
        rival = ours._replace(process=(lead - behind)[:, None])
        taken = Present(np.zeros((200, 6, 1)), np.full(7, 20.0), np.zeros((200, 1)))
        isolated, _ = eliminated(found, rival, taken, LIMITS, np.full(200, 1))
        np.testing.assert_array_equal(isolated.any(axis=-1), expected)


def test_a_second_sensor_competes_with_what_begins_now_on_the_readings_that_are_left() -> None:
    """Innovations (40, 15, 15), S = I: sensor 0 first; the two others are one unit of a hypothesis that moves both."""
    d = np.array([40.0, 15.0, 15.0])
    found = LeaveOneOut(d, np.ones(3), np.eye(3), np.ones(3, bool), None, None)
    sizes = np.array([20.0, 20.0, 20.0, 30.0])
    both = Present(np.array([[0.0], [1.0], [1.0]]), sizes, np.zeros(1))
    start = evidence([NOTHING] * 3, [0.0], one_sample_evidence(found, sizes[:3]))
    isolated, capped = eliminated(found, start, both, LIMITS, np.array(3))
    assert isolated.tolist() == [True, False, False] and not capped
    # with a handicap that outweighs its lead the sensors go one by one
    #   lead: (30^2 / 2) - 15^2 or so, less the logarithms
    a, b = 30.0, 2.0
    joint = a**2 * 30.0**2 / (1 + b * 30.0**2) - np.log1p(b * 30.0**2)
    single = 15.0**2 * 400 / 401 - np.log1p(400.0)
    for more, expected in ((-0.1, [True, False, False]), (0.1, [True, True, True])):
        handicap = np.array([joint - single + float(LIMITS.sensor_margin) + more])
        # once sensor 1 is gone, too, sensor 2 is as well explained by a hypothesis of which only it remains
        again = eliminated(found, start, both._replace(handicap=handicap), LIMITS, np.array(3))[0]
        assert again.tolist() == expected


def test_evidence_of_the_sample_is_that_of_a_size_before_any_reading() -> None:
    """u^2 / w shrunk by the prior, less the logarithm; -inf for a sensor without reading."""
    found, _, _ = sampled(runs=5)
    size = np.linspace(1.0, 6.0, 6)
    got = one_sample_evidence(found, size)
    for r in range(5):
        for i in range(6):
            if not found.used[r, i]:
                assert got[r, i] == NOTHING
                continue
            u, w, s = found.whitened[r, i], found.weight[r, i], size[i]
            expected = u**2 / (w + s**-2) - np.log(1 + w * s**2)
            assert got[r, i] == pytest.approx(expected, rel=0, abs=rounding(1.0, 30) * (1 + u**2 / w))


def test_a_sensor_is_absorbed_where_the_windows_know_more_of_it_than_the_sample() -> None:
    now = evidence([[9.0, 0.0]] * 3, [[0.0]] * 3, one_sample=[[9.0 - ABSORBED - 0.1, 0], [9.0 - ABSORBED + 0.1, 0], [0, 0]])
    isolated = np.array([[True, False], [True, False], [False, True]])
    found = absorbed_before(now, isolated, np.zeros(3, int))
    assert found.tolist() == [True, False, False]  # the last is not isolated
    unused = evidence([NOTHING, 1.0], [0.0], one_sample=[NOTHING, 0.0])
    assert not absorbed_before(unused, np.array([True, False]), np.array(0))


@pytest.mark.parametrize(("odds", "earlier"), [(1.0, False), (2.0, False), (10.0, True), (1000.0, True)])
def test_an_earlier_onset_is_preferred_where_it_is_clearly_the_likelier_one(odds: float, earlier: bool) -> None:
    """Evidence is twice the logarithm of the odds: those of two to one may be chance, those of ten to one are not."""
    now = evidence([[20.0 + 2 * np.log(odds), 0.0]], [[0.0]], one_sample=[[20.0, 0.0]])
    assert absorbed_before(now, np.array([[True, False]]), np.array([0])).tolist() == [earlier]


def test_a_lead_is_counted_while_the_fault_has_its_sign() -> None:
    led = np.zeros(3)
    for leads, fault, expected in (
        ([True, True, False], [2.0, -1.0, 5.0], [1, -1, 0]),
        ([True, True, True], [1.0, -3.0, 0.5], [2, -2, 1]),
        ([True, False, True], [-1.0, -3.0, 0.5], [-1, 0, 2]),
        ([True, True, True], [-2.0, -3.0, 0.5], [-2, -1, 3]),
    ):
        led = led_by(led, np.array(leads), np.array(fault))
        np.testing.assert_array_equal(led, expected)


def test_alternatives_to_the_accepted_one_are_those_within_the_margin() -> None:
    """1, 5 and 12 behind the best: a weight is the ratio of the probabilities, exp(-1 / 2), or the least one."""
    now = evidence([[0.0]] * 2, [[39.0, 40.0, 35.0, 28.0]] * 2, statistic=100.0)
    by_windows = accepted(now, LIMITS, np.array([True, False]))
    found = alternatives(now, by_windows, 10.0)
    np.testing.assert_allclose(found[0], [np.exp(-0.5), 0.0, max(np.exp(-2.5), LEAST_WEIGHT), 0.0], rtol=rounding(1.0, 4))
    assert not found[1].any()  # nothing is accepted there
    missing = evidence([0.0], [40.0, NOTHING])
    assert not alternatives(missing, accepted(missing, LIMITS, np.array(True)), 10.0).any()
