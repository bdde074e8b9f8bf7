"""When an estimator has broken down, and how the other runs of its batch continue; literal arrays."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.health import broken, keep_broken_out, without_broken


@pytest.mark.parametrize(
    ("x", "p", "expected"),
    [
        ([1.0, 2.0], [[1.0, 0.5], [0.5, 2.0]], False),
        ([1.0, 2.0], [[0.0, 0.0], [0.0, 0.0]], False),  # certain, but no contradiction
        ([1.0, 2.0], [[1.0, -0.5], [-0.5, 2.0]], False),  # covariances may be negative
        ([1.0, np.nan], [[1.0, 0.5], [0.5, 2.0]], True),
        ([np.inf, 2.0], [[1.0, 0.5], [0.5, 2.0]], True),
        ([1.0, 2.0], [[1.0, np.nan], [0.5, 2.0]], True),
        ([1.0, 2.0], [[1.0, 0.5], [0.5, np.inf]], True),
        ([1.0, 2.0], [[1.0, 0.5], [0.5, -1e-300]], True),
    ],
)
def test_an_estimate_is_broken_where_it_is_no_number_or_a_variance_negative(
    x: list[float], p: list[list[float]], expected: bool
) -> None:
    assert bool(broken(np.array(x), np.array(p))) is expected
    sound = np.zeros(2), np.eye(2)
    found = broken(np.stack([sound[0], np.array(x)]), np.stack([sound[1], np.array(p)]))
    assert found.tolist() == [False, expected]  # each run for itself


def test_broken_runs_are_replaced_and_the_others_stay() -> None:
    core = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), np.arange(12.0).reshape(3, 2, 2), np.array([7.0, 8.0, 9.0])
    fresh = tuple(-a for a in core)
    found = keep_broken_out(np.array([False, True, False]), core, fresh)
    np.testing.assert_array_equal(found[0], [[1, 2], [-3, -4], [5, 6]])
    np.testing.assert_array_equal(found[1], [[[0, 1], [2, 3]], [[-4, -5], [-6, -7]], [[8, 9], [10, 11]]])
    np.testing.assert_array_equal(found[2], [7, -8, 9])
    assert keep_broken_out(np.zeros(3, bool), core, fresh) is core


def test_a_decision_of_a_broken_run_has_no_number_and_isolates_nothing() -> None:
    numbers = {"estimate": 2, "reconstruction": 3, "residual": 3, "threshold": 3, "fault_size": 4}
    numbers |= {"process_size": 2, "process_sd": 2, "probability": 6}
    given = Decision(
        **{name: np.ones((2, width)) for name, width in numbers.items()},
        process=np.ones((2, 2), bool), suspect=np.ones((2, 6), bool),
        isolated=np.ones((2, 4), bool), diverged=np.zeros(2, bool), guarded=np.ones(2, bool), nis=np.ones(2),
        covariance=np.ones((2, 2, 2)), capped=np.ones(2, bool),
    )  # fmt: skip
    found = without_broken(given, np.array([True, False]))
    for name in (*numbers, "nis", "covariance"):
        assert np.isnan(getattr(found, name)[0]).all(), name
    assert not found.isolated[0].any() and not found.capped[0] and not found.alarm[0]
    assert found.process is not None and not found.process[0].any()
    assert found.suspect is not None and not found.suspect[0].any()
    assert found.guarded.tolist() == [True, True] and found.diverged.tolist() == [True, False]
    for field in fields(Decision):
        if field.name not in ("diverged", "absurd", "absurd_input", "shown_by"):
            np.testing.assert_array_equal(getattr(found, field.name)[1], getattr(given, field.name)[1], field.name)
    assert without_broken(replace(given, covariance=None), np.array([True, False])).covariance is None
    of_sensors = replace(given, process=None, process_size=None, process_sd=None, suspect=None, probability=None)
    lost = without_broken(of_sensors, np.array([True, False]))
    assert lost.process is lost.process_size is lost.process_sd is lost.suspect is lost.probability is None
    sound = without_broken(given, np.zeros(2, bool))
    assert sound.estimate is given.estimate and not sound.diverged.any()
    assert not without_broken(replace(given, diverged=np.ones(2, bool)), np.zeros(2, bool)).diverged.any()
