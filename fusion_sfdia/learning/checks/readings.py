"""Checks with missing, absurd and malformed readings, and the healthy readings of all checks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Detector, run
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.checks.require import require, require_numbers, require_refused, require_same
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
Healthy = Callable[[int, int], tuple[Array, Array, Array]]  # from steps K and runs B: t (K,), y (K, B, N), u (K, B, m)

SETTLED = 20  # samples in which filters forget their initial covariance
ABSURD = (1e303, -1e303, 1e308, -1e308, 1e160, -1e160, 1e30, -1e30)


def healthy_readings(plant: Plant) -> Healthy:
    """Readings of a plant's usual truth, simulated once for each size; read-only."""

    @cache
    def healthy(steps: int, runs: int) -> tuple[Array, Array, Array]:
        recording = simulate(plant, steps, range(50, 50 + runs))
        recording.y.flags.writeable = False
        return recording.t, recording.y, recording.u_of_runs

    return healthy


def missing_readings_are_no_evidence(detector: Detector, healthy: Healthy) -> None:
    """NaN readings, of some sensors or of all, raise no alarm and isolate nothing; estimates stay finite."""
    t, y, u = healthy(40, 2)
    gone = np.random.default_rng(1).random(y.shape) < 0.3
    gone[0] = True  # before anything was read
    gone[20:24] = True
    gone[30:34, 0, 1:] = True  # one sensor left
    gone[30:34, 1, next(iter(detector.plant.quantities.values()))] = True  # a whole quantity
    y = np.where(gone, np.nan, y)
    _, d = run(detector, detector.init((2,)), t, y, u)
    isolated = d.isolated[..., : gone.shape[-1]]
    require_numbers(d, "missing readings")
    require(not isolated[gone].any(), "a sensor that is not read is not isolated", isolated[gone])
    require(np.all(np.isnan(d.residual[gone])), "the residual of a missing reading is NaN", d.residual[gone])
    require(not d.alarm[np.all(gone, axis=-1)].any(), "there is no alarm where nothing is read", d.alarm)
    kept = ~gone & ~isolated
    assert_array_equal(d.reconstruction[kept], y[kept], "readings that are neither missing nor isolated are kept")


def absurd_values_are_replaced(detector: Detector, healthy: Healthy) -> None:
    """Readings such as 1e303 are taken as missing, such inputs as the usual ones, and the Decision reports both."""
    plant = detector.plant
    t, y, u = healthy(SETTLED + 6, len(ABSURD))
    bad_y, gone, bad_u, usual = y.copy(), y.copy(), u.copy(), u.copy()
    for b, value in enumerate(ABSURD):  # one run for each
        i = b * len(plant.sensors) // len(ABSURD)
        bad_y[SETTLED, b, i], gone[SETTLED, b, i] = value, np.nan
        if plant.inputs:  # of all inputs in turn, two steps later
            j = b * len(plant.inputs) // len(ABSURD)
            bad_u[SETTLED + 2, b, j], usual[SETTLED + 2, b, j] = value, plant.input_at(float(t[SETTLED + 1]))[j]
    _, d = run(detector, detector.init((len(ABSURD),)), t, bad_y, bad_u)
    _, expected = run(detector, detector.init((len(ABSURD),)), t, gone, usual)
    require_numbers(d, "absurd readings and inputs")
    assert_array_equal(d.absurd, np.isnan(gone), "absurd readings are reported")
    assert_array_equal(d.absurd_input, bad_u != u, "absurd inputs are reported")
    require(not expected.absurd.any() and not expected.absurd_input.any(), "missing readings are not absurd", expected.absurd)
    require_same(replace(d, absurd=expected.absurd, absurd_input=expected.absurd_input), expected, "absurd readings")


def a_silent_sensor_is_used_again(detector: Detector, healthy: Healthy) -> None:
    """A sensor without readings for 20 samples is not isolated when it returns, and its readings are kept."""
    t, y, u = healthy(50, 2)
    y = y.copy()
    i = len(detector.plant.sensors) // 2
    y[SETTLED:40, :, i] = np.nan
    _, d = run(detector, detector.init((2,)), t, y, u)
    require_numbers(d, "a silent sensor")
    require(not d.isolated[SETTLED:, :, i].any(), "a sensor that was silent is not isolated", d.isolated[SETTLED:, :, i])
    require(np.all(np.isfinite(d.residual[40:, :, i])), "it has residuals again", d.residual[40:, :, i])
    assert_array_equal(d.reconstruction[40:, :, i], y[40:, :, i], "its readings are kept")


def what_does_not_fit_is_refused(detector: Detector, healthy: Healthy) -> None:
    """Readings, inputs and times of other shapes, infinite readings, unknown inputs and times that do not increase."""
    times, ys, us = healthy(2, 1)
    t, y, u = float(times[0]), ys[0, 0], us[0, 0]
    state = detector.init()
    infinite = np.where(np.arange(y.size) == 0, np.inf, y)
    for bad in (y[:-1], np.append(y, 0.0), y[None], infinite):
        require_refused(f"readings {bad}", detector.step, state, t, bad, u)
    for bad in (np.append(u, 0.0), np.stack([u, u]), *([np.full_like(u, np.nan)] if u.size else [])):
        require_refused(f"inputs {bad}", detector.step, state, t, y, bad)
    for time in (0.0, -detector.plant.dt, np.nan, np.inf):
        require_refused(f"time {time} after 0", detector.step, state, time, y, u)
    require_refused("the readings of one run for a batch of two", detector.step, detector.init((2,)), t, y, u)
