"""Adaptive thresholds: valid by proof and by count, one source with the compiled driver, what is missing, what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fusion_sfdia.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.corner_bounds import prove, slopes
from fusion_sfdia.detector import Decision, run
from fusion_sfdia.models.marine_engine import OBSERVER_BOUNDS, engine_equations, marine_engine
from fusion_sfdia.modules import Modules
from fusion_sfdia.simulate import Recording, simulate

ENGINE = marine_engine()
DETECTOR = AdaptiveThreshold(ENGINE)
BOUND = np.array([s.noise_bound for s in ENGINE.sensors])


@cache
def healthy(steps: int, runs: int) -> Recording:
    return simulate(ENGINE, steps, range(runs), truth="model")


def judge(detector: AdaptiveThreshold, y: np.ndarray, recording: Recording) -> Decision:
    u = np.broadcast_to(recording.u[:, None], (*y.shape[:2], recording.u.shape[-1]))
    return run(detector, detector.init((y.shape[1],)), recording.t, y, u)[1]


def test_slopes_of_a_known_function_are_proved() -> None:
    low, high = np.array([1.0, -1.0, 0.5]), np.array([2.0, 1.0, 3.0])
    least, most = slopes(lambda a, b, c: a * a * c - b * c + b * b, low, high)
    # derivatives 2ac in [1, 12], 2b - c in [-5, 1.5], a^2 - b in [0, 5]
    assert np.all(least <= [1, -5, 0]) and np.all(most >= [12, 1.5, 5])
    np.testing.assert_allclose(least[[0, 2]], [1, 0], atol=1e-9)


def test_corners_enclose_the_engine_over_the_envelope() -> None:
    """Ten thousand points in boxes of the noise's size, anywhere in the envelope."""
    rng = np.random.default_rng(1)
    m = ENGINE.modules
    assert m is not None
    settings = DETECTOR._settings
    centre = DETECTOR.nominal + (DETECTOR.half_width - DETECTOR._bound) * rng.uniform(-1, 1, (100, 10))
    u = np.ones((100, 1))
    _, _, lower, upper = DETECTOR._monitor(centre[:, :3], np.zeros((100, 3)), centre, centre, u, 0.01, settings)
    for _ in range(100):
        at = dict(zip(m.equations, (centre + settings.bound * rng.uniform(-1, 1, centre.shape)).T, strict=True))
        for k, (name, function) in enumerate(list(m.equations.items())[3:]):
            names = function.__code__.co_varnames[: function.__code__.co_argcount - 1]
            value = function(*(at[a] for a in names), m.parameters)
            assert np.all((lower[:, k] <= value) & (value <= upper[:, k])), name


def test_the_compiled_driver_is_the_same_source() -> None:
    assert ENGINE.modules is not None
    plain = AdaptiveThreshold(replace(ENGINE, modules=replace(ENGINE.modules, monitor=None)))
    recording = healthy(60, 3)
    y = recording.y.copy()
    y[20:30, 1, ::3] = np.nan
    y[40:, 2, 3] -= 3.8e4
    one, other = judge(DETECTOR, y, recording), judge(plain, y, recording)
    np.testing.assert_allclose(one.residual, other.residual, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(one.threshold, other.threshold, rtol=1e-12)


def test_thresholds_in_noise_bounds() -> None:
    """Of the observers: 1.017, 2.3 (2.2 had the readings of one instant sufficed) and 2.00 for "valid", (10) for "paper"."""
    recording = healthy(400, 4)
    ratio = (judge(DETECTOR, recording.y, recording).threshold / BOUND)[50:].mean(axis=(0, 1))
    np.testing.assert_allclose(ratio[[0, 7]], [1.017, 2.001], atol=2e-3)
    assert 2.2 < ratio[4] < 2.5 and ratio[8] == pytest.approx(1.0, rel=1e-9)
    paper = judge(replace(DETECTOR, observer_bounds=OBSERVER_BOUNDS), recording.y, recording)
    np.testing.assert_allclose((paper.threshold / BOUND)[-1, :, [0, 4, 7]].mean(axis=-1), [1.10, 1.90, 1.711], atol=5e-3)


def test_healthy_readings_never_alarm() -> None:
    recording = healthy(2000, 25)  # half a million module-samples here; ten million in the slow test
    d = judge(DETECTOR, recording.y, recording)
    assert not d.alarm.any() and d.scores.max() <= 1.0


@pytest.mark.slow
def test_ten_million_healthy_module_samples_raise_no_alarm() -> None:
    recording = simulate(ENGINE, 10_000, range(100, 200), truth="model")
    d = judge(DETECTOR, recording.y, recording)
    assert d.scores.size >= 10_000_000 and not d.alarm.any()


def test_a_faulty_torque_sensor_is_among_the_isolated() -> None:
    recording = healthy(300, 5)
    y = recording.y.copy()
    y[100:, :, 3] -= 3.8e4
    d = judge(DETECTOR, y, recording)
    assert not d.alarm[:100].any() and d.isolated[101:, :, 3].all() and not d.isolated[:, :, [6, 7, 8, 9]].any()


def test_missing_readings_widen_and_never_alarm() -> None:
    recording = healthy(300, 5)
    y = recording.y.copy()
    y[50:150, :, 1::2] = np.nan
    y[200] = np.nan
    d = judge(DETECTOR, y, recording)
    assert not d.alarm.any() and np.isnan(d.residual[60, :, 1::2]).all() and np.isfinite(d.measured).all()


def test_what_is_refused() -> None:
    assert ENGINE.modules is not None
    modules: Modules = ENGINE.modules
    with pytest.raises(ValueError, match="does not say its scalar equations"):
        AdaptiveThreshold(replace(ENGINE, modules=None))
    with pytest.raises(ValueError, match="observer of fuel has the gain -100"):
        replace(modules, gains={**modules.gains, "fuel": -100.0})
    with pytest.raises(ValueError, match="margins names nothing"):
        AdaptiveThreshold(ENGINE, margins={"nothing": 0.1})
    with pytest.raises(ValueError, match="have no noise bound"):
        sensors = tuple(replace(s, bound=None, sigma=s.noise_sigma) for s in ENGINE.sensors)
        AdaptiveThreshold(replace(ENGINE, sensors=sensors))
    with pytest.raises(ValueError, match="no finite range"):
        table = {"torque": engine_equations("law")["torque"]}
        prove(table, ("torque",), np.array([1.0]), np.array([1.0]), modules.parameters)
