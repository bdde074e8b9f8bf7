"""The second look at a log, without the readings that were isolated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors.kalman_banks import steady_gains
from fusion_sfdia.diagnosis.hindsight import Hindsight, hindsight, left_out
from fusion_sfdia.diagnosis.hindsight import _batch_step as batch_step
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.plant.gaps import Track, bridged
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
PLANT = tanks()


def test_readings_before_an_isolation_are_left_out_too() -> None:
    isolated = np.zeros((10, 2), bool)
    isolated[6, 0] = True
    assert np.flatnonzero(left_out(isolated, lead=3)[:, 0]).tolist() == [3, 4, 5, 6]
    assert not left_out(isolated)[:, 1].any() and left_out(isolated)[:7, 0].all() and not left_out(isolated)[7:].any()


def test_the_residual_of_a_reading_is_what_it_is_without_it() -> None:
    """u / w and 1 / w of the innovations against a filter that leaves out this one reading."""
    t, _, y, u = readings(PLANT, 12, 1, seed=0)
    y, u = y[:, 0], u[:, 0]
    track, _ = bridged(PLANT, Log(t, y, u))
    whole = hindsight(PLANT, track, np.zeros(y.shape, bool))
    out = np.zeros(y.shape, bool)
    out[-1, 0] = True  # a level: its output is linear, so that both are the same
    one = hindsight(PLANT, track, out)
    tolerance = rounding(1e6, 100)
    np.testing.assert_allclose(one.error[-1, 0], whole.error[-1, 0], rtol=tolerance)
    np.testing.assert_allclose(one.sd[-1, 0], whole.sd[-1, 0], rtol=tolerance)
    assert np.isnan(one.normal[-1, 0]) and one.used[-1] == 3 and whole.used[-1] == 4


def test_the_innovations_are_those_of_an_extended_kalman_filter() -> None:
    t, _, y, u = readings(PLANT, 12, 1, seed=0)
    y, u = y[:, 0].copy(), u[:, 0]
    y[3, 1] = np.nan
    track, _ = bridged(PLANT, Log(t, y, u))
    found = hindsight(PLANT, track, np.zeros(y.shape, bool))
    filter_, rng = Extended(), step_stream(0, 0)
    core, before = filter_.start(PLANT, (), rng), 0.0
    for k, now in enumerate(t.tolist()):
        prior = filter_.predict(PLANT, core, before, u[k], now - before, rng)
        joint = filter_.joint(PLANT, prior, now, u[k])
        after = condition(joint, y[k])
        np.testing.assert_array_equal(found.normal[k], after.innovation / np.sqrt(np.diagonal(joint.S)))
        assert found.nis[k] == after.nis
        core, before = GaussianState(after.x, after.P), now


def test_residuals_have_the_standard_deviation_that_is_stated() -> None:
    """Of 4 x 480 residuals of readings in use and 480 of one that is never used, by 4 standard errors of correlated ones."""
    recording = simulate(PLANT, 500, [0], truth="model", process_noise=True)
    track, _ = bridged(PLANT, Log(recording.t, recording.y[:, 0], recording.u_of_runs[:, 0]))
    for out in (np.zeros((500, 4), bool), np.broadcast_to(np.arange(4) == 1, (500, 4))):
        found = hindsight(PLANT, track, out)
        z = (found.error / found.sd)[20:]
        # white noise of the sensor is most of it; what is common lasts for a few samples
        assert np.all(np.abs(np.mean(z**2, axis=0) - 1) < 4 * np.sqrt(2 / 480 * 3))


def test_after_the_filter_breaks_down_nothing_is_known() -> None:
    t, _, y, u = readings(PLANT, 12, 1, seed=0)
    track, _ = bridged(PLANT, Log(t, y[:, 0], u[:, 0]))
    broken = track._replace(u=np.where(track.t[:, None] > 30, np.nan, track.u))
    found = hindsight(PLANT, broken, np.zeros((12, 4), bool))
    assert np.isfinite(found.error[:6]).all() and np.isnan(found.error[6:]).all() and found.used[6:].sum() == 0


def of_parts(monkeypatch: pytest.MonkeyPatch, plant: Plant, track: Track, out: Array) -> tuple[Hindsight, Hindsight, int]:
    """In parts and in order, and how many steps were batches."""
    module, batches = "fusion_sfdia.diagnosis.hindsight", []

    def counted(*arguments: Any) -> Any:
        batches.append(1)
        return batch_step(*arguments)

    monkeypatch.setattr(f"{module}._batch_step", counted)
    monkeypatch.setattr(f"{module}.FEWEST", 10**9)
    in_order = hindsight(plant, track, out)
    assert not batches
    monkeypatch.setattr(f"{module}.FEWEST", 2)
    monkeypatch.setattr(f"{module}.SHORTEST", 200)
    return hindsight(plant, track, out), in_order, len(batches)


def test_a_long_log_is_filtered_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Missing readings, readings left out, an uneven step and a fresh start; the filter forgets within a part."""
    t, _, y, u = readings(PLANT, 1000, 1, seed=0)
    y, u, t = y[:, 0].copy(), u[:, 0], t.copy()
    y[150:170, 1], y[420] = np.nan, np.nan
    t[500:] += 0.4 * PLANT.dt
    t[700:] += 2e5 * PLANT.dt
    track, _ = bridged(PLANT, Log(t, y, u))
    out = np.zeros(y.shape, bool)
    out[300:350, 0] = True
    found, expected, batches = of_parts(monkeypatch, PLANT, track, out)
    assert 200 < batches < 200 + 200 + 200  # to see whether it forgets, the first sweep, the second one
    np.testing.assert_array_equal(found.used, expected.used)
    for one, other in zip(found[:4], expected[:4], strict=True):  # SAME, amplified by what a residual is of its parts
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-7 * np.nanmax(np.abs(other)))


def test_a_model_that_looks_at_the_time_is_filtered_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    t, _, y, u = readings(PLANT, 500, 1, seed=0)
    track, _ = bridged(PLANT, Log(t, y[:, 0], u[:, 0]))

    def step(t_start: float, x: Array, u: Array, dt: float) -> Array:
        return PLANT.step(t_start, x, u, dt) * (1.01 if t_start > 1000 else 1.0)

    found, expected, batches = of_parts(monkeypatch, replace(PLANT, step=step), track, np.zeros((500, 4), bool))
    assert batches == 1
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_filter_that_forgets_nothing_is_continued_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = replace(PLANT, process_cov=1e-12 * PLANT.process_cov, initial_cov=1e-4 * PLANT.initial_cov)
    t, _, y, u = readings(PLANT, 500, 1, seed=0)
    track, _ = bridged(PLANT, Log(t, y[:, 0], u[:, 0]))
    found, expected, batches = of_parts(monkeypatch, plant, track, np.zeros((500, 4), bool))
    assert batches == 199  # to see that it does not
    for one, other in zip(found[:4], expected[:4], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-7 * np.nanmax(np.abs(other)))


def test_in_parts_nothing_is_known_after_the_filter_breaks_down(monkeypatch: pytest.MonkeyPatch) -> None:
    t, _, y, u = readings(PLANT, 1000, 1, seed=0)
    track, _ = bridged(PLANT, Log(t, y[:, 0], u[:, 0]))
    broken = track._replace(u=np.where(np.arange(1000)[:, None] >= 650, np.nan, track.u))
    found, _, _ = of_parts(monkeypatch, PLANT, broken, np.zeros((1000, 4), bool))
    assert np.isfinite(found.error[:650]).all() and np.isnan(found.error[650:]).all() and found.used[650:].sum() == 0


def test_gains_at_rest_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault that is left out and a sensor that stays silent, each for longer than it takes its gains to come to rest."""
    plant = chain(6, process=0.5)
    recording = simulate(plant, 600, seeds=[1], truth="model", process_noise=True)
    y = recording.y[:, 0].copy()
    y[320:470, 4] = np.nan
    y[520, 1] = np.nan
    out = np.zeros(y.shape, bool)
    out[100:250, 2] = True
    track, _ = bridged(plant, Log(recording.t, y, recording.u))
    exact = hindsight(plant, track, out)
    monkeypatch.setattr(steady_gains, "LARGE", 8)
    rests: list[Array] = []

    def counted(of: Plant, gains: steady_gains.Gains, *rest: Any) -> Any:
        rests.append(gains.used)
        return steady_gains.predicted(of, gains, *rest)

    monkeypatch.setattr("fusion_sfdia.diagnosis.hindsight.predicted", counted)
    found = hindsight(plant, track, out)
    assert len(rests) > 200 and {tuple(np.flatnonzero(~used)) for used in rests} == {(), (2,), (4,)}
    tolerance = 10 * steady_gains.SAME  # of standard deviations
    np.testing.assert_allclose(found.sd, exact.sd, rtol=tolerance)
    np.testing.assert_allclose(found.error / exact.sd, exact.error / exact.sd, atol=tolerance)
    np.testing.assert_allclose(found.normal, exact.normal, atol=tolerance)
    np.testing.assert_allclose(found.nis, exact.nis, rtol=tolerance)
    np.testing.assert_array_equal(found.used, exact.used)
