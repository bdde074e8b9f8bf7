"""One way to fit every registered detector: from healthy readings at a rate of false alarms, by class and by name."""

from __future__ import annotations

import inspect
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optional_packages import REGISTERED, needs_toolbox
from scipy.stats import betabinom
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.batch_detector import BatchDetector
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.saved_detectors import load_detector, save_detector
from fusion_sfdia.detectors.structural_residuals.structural_residuals import StructuralResiduals
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.learning.builders import fit
from fusion_sfdia.plant.log import Log

PLANT = "two-tanks"
RATE = 0.02
STEPS, SETTLED = 80, 20
LEARN = {f"fusing-{kind}" for kind in ("ekf", "ukf", "enkf")} | {"filterpy-ekf", "filterpy-ukf"}
LEARN |= {"frozen-model", "limits", "limits-ewma", "pca", "dynamic-pca", "one-class", "structural-residuals"}
every_detector = pytest.mark.parametrize("name", REGISTERED)


@cache
def healthy(first: int, runs: int) -> Recording:
    return simulate(registry.plant(PLANT), STEPS, range(first, first + runs), process_noise=True)


@cache
def fitted(name: str) -> Any:
    return fit(name, PLANT, healthy(0, 40), RATE)


def test_those_that_learn_are_registered_so() -> None:
    assert {name for name, entry in registry.detectors().items() if entry.learns} == LEARN


@every_detector
def test_fit_has_one_shape(name: str) -> None:
    kind = type(fitted(name))
    assert issubclass(kind, BatchDetector)
    shape = list(inspect.signature(kind.fit).parameters.values())
    assert [p.name for p in shape[:3]] == ["plant", "healthy", "false_alarm"] and shape[2].default == 1e-3
    assert all(p.kind in (p.KEYWORD_ONLY, p.VAR_KEYWORD) for p in shape[3:])


@every_detector
def test_the_rate_is_kept_on_fresh_readings_until_something_is_isolated(name: str) -> None:
    """First alarms among the samples before them: at most RATE, with the margin of the samples that set the limit.

    Of M samples the limit leaves a share that is Beta distributed about the rate; samples follow each other, so that a fourth
    of them count, for the fit and for the test alike. Some alarm: a limit that nothing crosses would not be at the rate.
    """
    detector = fitted(name)
    fresh = healthy(500, 40)
    alarm = run(detector, detector.init(40), fresh)[1].alarm[SETTLED:]
    first = np.where(alarm.any(axis=0), np.argmax(alarm, axis=0) + 1, len(alarm))
    samples, alarms = int(first.sum()), int(alarm.any(axis=0).sum())
    count = 40 * (STEPS - SETTLED) // 4 // (2 if name in LEARN else 1)
    most = betabinom.ppf(1 - 1e-4, samples // 4, max(1, RATE * count), count * (1 - RATE))
    assert 0 < alarms <= 4 * most


@every_detector
def test_saved_and_loaded_it_decides_with_the_same_bits(name: str, tmp_path: Path) -> None:
    detector = fitted(name)
    save_detector(tmp_path / "detector.npz", detector)
    loaded = load_detector(tmp_path / "detector.npz", registry.plant(PLANT))
    data = healthy(700, 2)
    y = data.y.copy()
    y[40:, :, 0] += 20 * detector.plant.sensor_sigma[0]
    (_, a), (_, b) = (run(d, d.init(2, seed=3), Log(data.t, y, data.u)) for d in (detector, loaded))
    for f in fields(Decision):
        np.testing.assert_array_equal(getattr(a, f.name), getattr(b, f.name), err_msg=f.name)


@every_detector
def test_too_few_readings_for_the_rate_are_a_clear_error(name: str) -> None:
    with pytest.raises(
        ValueError,
        match=r"healthy (samples|scores) cannot set .*; give .*(higher (false-alarm )?rate|larger probability)",
    ):
        fit(name, PLANT, healthy(0, 2), 1e-4)


def test_without_readings_the_registered_seeds_are_simulated() -> None:
    named, built = fit("limits", PLANT), registry.detector("limits", registry.plant(PLANT))
    np.testing.assert_array_equal(named.level, built.level)  # type: ignore[attr-defined]
    wide = fit("kf-chi2", PLANT, false_alarm=0.02)
    assert wide.threshold_scale < 1  # type: ignore[attr-defined]


def test_thresholds_are_the_order_statistic_of_the_scores() -> None:
    """Of M scores 1 - rate stay within the scale, to the next whole number; fitting again changes nothing."""
    plant = chain(4)
    t, _, y, u = readings(plant, 120, 10, seed=0)
    detector = CentralFilter.fit(plant, (t, y, u), 0.05)
    assert detector.fit_thresholds((t, y, u), 0.05) == detector
    _, d = run(detector, detector.init(10), t, y, u)  # it isolates nothing that acts on the estimate
    assert np.sum(d.score[20:] > 1) == 1000 - np.ceil(1001 * 0.95)
    with pytest.raises(ValueError, match=r"1000 healthy samples cannot set thresholds that one in 2000 exceeds"):
        detector.fit_thresholds((t, y, u), 5e-4)
    for bad, message in ((1.0, "false_alarm is 1.0; expected a probability"), (0.1, "warm_up is -1")):
        with pytest.raises(ValueError, match=message):
            detector.fit_thresholds((t, y, u), bad, -1)
    with pytest.raises(ValueError, match=r"exceeds 0, .* of CentralFilter has that false-alarm rate"):
        detector.fit_thresholds((t, np.full_like(y, np.nan), u), 0.1)
    with pytest.raises(ValueError, match=r"the readings are None; expected t, y and u"):
        CentralFilter.fit(plant, None)


@needs_toolbox
def test_readings_that_are_not_a_step_apart_are_refused_where_states_are_integrated() -> None:
    recording = healthy(0, 40)
    with pytest.raises(ValueError, match=r"the healthy readings are not 5 s apart"):
        StructuralResiduals.fit(registry.plant(PLANT), (2 * recording.t, recording.y, recording.u_of_runs), RATE)


def test_diagnose_takes_a_detector_by_name() -> None:
    recording = simulate(tanks(), 30, [0])
    y = recording.y[:, 0] + 30 * tanks().sensor_sigma * np.eye(4)[1] * (recording.t > 75)[:, None]
    found = diagnose("kf-chi2", recording.t, y, recording.u, plant=PLANT)
    assert (
        found.events[0].hypothesis == "l2"
        and found.events == diagnose("kf-chi2", (recording.t, y, recording.u), plant=tanks()).events
    )
    with pytest.raises(ValueError, match=r"detector 'kf-chi2' has no plant yet; pass plant="):
        diagnose("kf-chi2", recording)
    with pytest.raises(ValueError, match=r"unknown detector 'kf-chi'; did you mean 'kf-chi2'"):
        diagnose("kf-chi", recording, plant=PLANT)
    with pytest.raises(ValueError, match=r"unknown plant 'tanks'"):
        fit("kf-chi2", "tanks")
    with pytest.raises(
        ValueError, match=r"a plant is given together with a detector, which has its own, 'two-tanks'; leave it out"
    ):
        diagnose(CentralFilter(tanks()), recording, plant=PLANT)


def test_diagnose_takes_a_class_or_function_that_builds_a_detector() -> None:
    recording = simulate(tanks(), 30, [0])
    expected = diagnose(CentralFilter(tanks()), recording)
    for build in (CentralFilter, lambda plant: CentralFilter(plant), registry.NamedDetector("mine", "", CentralFilter)):
        found = diagnose(build, recording, plant=PLANT)
        np.testing.assert_array_equal(found.decisions.residual, expected.decisions.residual)
    with pytest.raises(ValueError, match=r"CentralFilter is a class; build it on a plant first, as in CentralFilter\(plant\)"):
        run(CentralFilter, CentralFilter(tanks()).init(), recording)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"detector 'CentralFilter' has no plant yet; pass plant="):
        diagnose(CentralFilter, recording)
    for wrong in (tanks(), None):
        with pytest.raises(
            ValueError, match=r"the first argument is of type (Plant|NoneType); expected a detector or its name"
        ):
            diagnose(wrong, recording, plant=PLANT)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="built Plant; expected a Detector"):
        diagnose(lambda plant: plant, recording, plant=PLANT)  # type: ignore[arg-type,return-value]


def test_fit_refuses_settings_that_it_has_not() -> None:
    with pytest.raises(ValueError, match="fit has no settings sigma; it has healthy and false_alarm: build"):
        fit("limits", PLANT, sigma=1)
