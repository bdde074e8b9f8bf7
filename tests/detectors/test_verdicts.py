"""A verdict that nothing supports is never "healthy": of a sample, and of a log."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from optional_packages import STRUCTURAL
from toy_plants import declared, readings, tanks

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.batch_detector import HELD
from fusion_sfdia.detectors.detector import Decision, chosen
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.verdicts import Verdict, conclusion_of
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.report.log_report import as_text

Array = np.ndarray[Any, Any]
DETECTORS = (
    "loo-chi2",
    "kf-chi2",
    "limits",
    "pca",
    STRUCTURAL,
    "adaptive-threshold",
    "chebyshev",
    "chebyshev:paper",
)


def decision(**changes: Any) -> Decision:
    """Of a healthy sample of three sensors."""
    zeros, off = np.zeros(3), np.zeros(3, bool)
    found = Decision(zeros, zeros, zeros, zeros + 1.0, off, zeros * np.nan, np.zeros((), bool), np.zeros((), bool), np.ones(()))
    return replace(found, **changes)


NAN, INF = np.full(3, np.nan), np.full(3, np.inf)
YES, FIRST = np.ones((), bool), np.array([True, False, False])
NO = np.zeros(3, bool)


@pytest.mark.parametrize(
    ("changes", "y", "verdict", "text"),
    [
        ({}, np.zeros(3), "healthy", "healthy"),
        ({"residual": np.array([0, np.nan, np.nan])}, np.array([0, np.nan, np.nan]), "healthy", "healthy"),
        ({"residual": NAN}, NAN, "blind", "no verdict: no sensor has a reading"),
        ({"residual": NAN, "absurd": ~NO}, np.full(3, 1e300), "blind", "no verdict: all readings are missing or impossible"),
        ({"residual": NAN}, np.zeros(3), "blind", "no verdict: no reading could be compared with the model"),
        ({"threshold": NAN}, np.zeros(3), "blind", "no verdict: no reading could be compared with the model"),
        ({"diverged": YES}, np.zeros(3), "blind", "no verdict: the estimate diverged, or the model gave no finite value"),
        ({"threshold": INF}, np.zeros(3), "cannot tell", "cannot tell: the thresholds allow no decision yet"),
        ({"residual": np.full(3, 1e4)}, np.zeros(3), "cannot tell", "cannot tell: all readings are far from the model"),
        (
            {"residual": np.full(3, -1e4), "isolated": FIRST},
            np.zeros(3),
            "cannot tell",
            "cannot tell: all readings are far from the model",
        ),
        (
            {"isolated": FIRST, "capped": YES},
            np.zeros(3),
            "cannot tell",
            "cannot tell: more sensors disagree with the model than can be isolated",
        ),
        ({"isolated": FIRST, "residual": np.array([1e4, 0, 0])}, np.zeros(3), "sensor", "sensor"),
        ({"process": FIRST, "isolated": FIRST}, np.zeros(3), "sensor", "sensor"),  # as the first finding
        ({"process": FIRST}, np.zeros(3), "process", "process"),
        ({"isolated": np.array([False, False, False, True])}, np.zeros(3), "process", "process"),
        ({"suspect": FIRST, "process": NO}, np.zeros(3), "cannot tell", "cannot tell: several hypotheses explain an alarm"),
        ({"residual": np.full(3, 1.5)}, np.zeros(3), "cannot tell", "cannot tell: an alarm, and nothing is isolated"),
        ({"absurd_input": YES}, np.zeros(3), "outside", "outside: an input is beyond the limits of its signal"),
    ],
)
def test_the_verdict_on_a_sample(changes: dict[str, Any], y: Array, verdict: str, text: str) -> None:
    found = conclusion_of(decision(**changes), y)
    assert found.verdict == verdict and found.text == text


def healthy(steps: int = 60) -> tuple[Array, Array, Array]:
    t, _, y, u = readings(tanks(), steps, 1, seed=1)
    return t, y[:, 0].copy(), u[:, 0]


def diagnosed(detector: Any, t: Array, y: Array, u: Array) -> Diagnosis:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what the verdict states
        return diagnose(detector, t, y, u)


def states(detector: Any, found: Diagnosis, y: Array) -> set[str]:
    return {str(conclusion_of(chosen(found.decisions, k), y[k]).verdict) for k in range(20, len(y))}


@pytest.mark.parametrize("name", DETECTORS)
@pytest.mark.parametrize("case", ["missing", "impossible", "far up", "far apart"])
def test_no_blind_sample_or_log_looks_healthy(name: str, case: str) -> None:
    t, y, u = healthy()
    sigma = tanks().sensor_sigma
    y[20:] = {
        "missing": np.nan * y[20:],
        "impossible": np.full_like(y[20:], 1e300),
        "far up": y[20:] + 1e4 * sigma,
        "far apart": y[20:] + 1e4 * sigma * np.array([1.0, -1.0, 1.0, -1.0]),
    }[case]
    detector = registry.detector(name, tanks())
    found = diagnosed(detector, t, y, u)
    expected = {"blind"} if case in ("missing", "impossible") else {"blind", "cannot tell", "sensor"}
    assert states(detector, found, y) <= expected
    assert found.state != "healthy" and "no fault" not in found.verdict
    alone = diagnosed(detector, t[20:], y[20:], u[20:]) if case == "impossible" else found
    assert alone.state != "healthy" and "no fault" not in as_text(alone, name)
    if case == "impossible":
        assert alone.state is Verdict.BLIND and alone.verdict.startswith("no verdict: no reading could be compared with the")


@pytest.mark.parametrize("name", ["loo-chi2", "loo-glr", "robust-glr", "kf-chi2", "fusing-ekf"])
@pytest.mark.parametrize("rows", [1, 20])
def test_rows_that_are_far_off_cost_no_more_than_themselves(name: str, rows: int) -> None:
    """All readings: no row before or some samples after them is other than without them, but for false alarms."""
    t, y, u = healthy(120)
    spoilt = y.copy()
    spoilt[60 : 60 + rows] += 1e4 * tanks().sensor_sigma * np.array([1.0, -1.0, 1.0, -1.0])
    detector = registry.detector(name, tanks())
    found, usual = (diagnosed(detector, t, of, u).decisions for of in (spoilt, y))
    assert all(str(conclusion_of(chosen(found, k), spoilt[k]).verdict) == "cannot tell" for k in range(60, 60 + rows))
    np.testing.assert_array_equal(found.isolated[60 : 60 + rows], usual.isolated[59:60].repeat(rows, axis=0))
    after = slice(60 + rows + 10, None)
    np.testing.assert_array_equal(found.isolated[after], usual.isolated[after])


def test_readings_that_stay_far_off_are_believed_in_the_end() -> None:
    """After `HELD` samples: then the plant is elsewhere, or its inputs are."""
    t, y, u = healthy(200)
    y[60:] += 1e4 * tanks().sensor_sigma
    found = diagnosed(registry.detector("kf-chi2", tanks()), t, y, u).decisions
    assert np.all(np.abs(found.estimate[60 : 60 + HELD] - 1) < 0.3)
    assert np.any(found.estimate[60 + HELD :] > 2.0)


def test_a_model_that_gives_no_number_is_no_verdict() -> None:
    t, y, u = healthy()
    plant = tanks()
    broken = replace(plant, output=lambda t, x, u: plant.output(t, x, u) * (np.nan if t > 100 else 1))
    found = diagnosed(CentralFilter(broken), t, y, u)
    assert found.state is Verdict.BLIND
    assert found.verdict == "no verdict: the estimate diverged, or the model gave no finite value, at 105 s"
    assert found.verdict in as_text(found, "kf") and "no fault" not in as_text(found, "kf")
    y[:, 1] += 2.0 * (t > 50)
    assert diagnosed(CentralFilter(broken), t, y, u).state is Verdict.SENSOR


def test_thresholds_that_decide_nothing_are_no_verdict() -> None:
    t, y, u = healthy()
    detector = replace(registry.detector("kf-chi2", tanks()), threshold_scale=1e308)
    with np.errstate(over="ignore"):
        found = diagnosed(detector, t, y, u)
    assert found.state is Verdict.UNDECIDED and found.verdict == "cannot tell: the thresholds allow no decision yet"


def test_the_state_of_a_log_is_that_of_its_events() -> None:
    t, y, u = healthy()
    bank = registry.detector("loo-chi2", tanks())
    assert diagnosed(bank, t, y, u).state is Verdict.HEALTHY and diagnosed(bank, t, y, u).verdict == "no fault"
    biased = y.copy()
    biased[20:, 0] += 0.5
    assert diagnosed(bank, t, biased, u).state is Verdict.SENSOR
    two = y.copy()
    two[20:] += np.array([20.0, -20.0, 20.0, 0.0]) * tanks().sensor_sigma
    found = diagnosed(bank, t, two, u)
    assert found.decisions.capped.any() and found.state is Verdict.UNDECIDED
    t, _, y3, u3 = readings(declared(), 160, 1, seed=2)
    y2 = y3[:, 0].copy()
    y2[30:] += 4.0
    assert diagnosed(registry.detector("robust-glr", declared()), t, y2, u3[:, 0]).state is Verdict.PROCESS
