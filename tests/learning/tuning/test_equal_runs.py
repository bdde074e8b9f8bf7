"""Healthy logs of several lengths, with gaps, as runs side by side."""

from __future__ import annotations

import numpy as np
import pytest
from toy_plants import chain, changed

from fusion_sfdia.learning.tuning.tune import as_even_runs
from fusion_sfdia.plant.log import Log

PLANT = changed(chain(2), fixed_dt=False)


def log(steps: int, first: float = 1.0, dt: float = 1.0) -> Log:
    t = first + dt * np.arange(steps)
    return Log(t, np.stack([t, -t], axis=1), np.empty((steps, 0)))


def test_one_log_is_one_run() -> None:
    found = as_even_runs(PLANT, [log(100)]).log
    assert found.y.shape == (100, 1, 2)
    np.testing.assert_array_equal(found.y[:, 0], log(100).y)


def test_a_gap_parts_a_log_and_each_part_begins_anew() -> None:
    first, second = log(300), log(290, first=5000.0)
    both = Log(*(np.concatenate(parts) for parts in zip(first, second, strict=True)))
    found, times, of = as_even_runs(PLANT, [log(100), both])
    assert found.y.shape == (290, 2, 2)
    np.testing.assert_array_equal(found.y[:, 1], second.y)
    np.testing.assert_array_equal(found.t, first.t[:290])
    np.testing.assert_array_equal(times, np.stack([first.t[:290], second.t], axis=1))
    assert of == (1, 1)


def test_the_length_is_that_which_uses_most_samples() -> None:
    assert as_even_runs(PLANT, [log(1000), log(310)]).log.y.shape == (310, 4, 2)
    assert as_even_runs(PLANT, [log(1000), log(60)]).log.y.shape == (1000, 1, 2)


def test_an_unevenly_sampled_log_stands_alone() -> None:
    uneven = log(200)
    uneven = uneven._replace(t=uneven.t + 0.3 * np.sin(np.arange(200)))
    assert as_even_runs(PLANT, [uneven, log(100)]).log.y.shape == (200, 1, 2)


def test_a_log_of_gaps_is_refused() -> None:
    t = np.concatenate([first + np.arange(30.0) for first in 200.0 * np.arange(8)])
    with pytest.raises(ValueError, match="no stretch of 40 samples without a gap of more than 60"):
        as_even_runs(PLANT, [Log(t, np.stack([t, -t], axis=1), np.empty((240, 0)))])


@pytest.mark.parametrize("fixed_dt", [True, False])
def test_skipped_rows_are_rows_without_readings(fixed_dt: bool) -> None:
    """A logger that drops a tenth of its rows, up to a minute in a row; a longer gap parts the log."""
    kept = np.random.default_rng(1).random(800) > 0.1
    kept[300:355], kept[[0, 400, 500, 799]] = False, True
    whole = log(800)
    found = as_even_runs(changed(PLANT, fixed_dt=fixed_dt), [whole.rows(kept)]).log
    np.testing.assert_allclose(found.t, whole.t, rtol=1e-12)
    np.testing.assert_array_equal(found.y[:, 0], np.where(kept[:, None], whole.y, np.nan))
    kept[401:500] = False
    parts = as_even_runs(changed(PLANT, fixed_dt=fixed_dt), [whole.rows(kept)])
    assert parts.log.y.shape[0] in (300, 400) and np.isnan(parts.log.y).any()


def test_a_log_slower_than_the_plant_steps_has_rows_without_readings() -> None:
    found = as_even_runs(changed(PLANT, max_dt=1.0), [log(200, dt=2.0)]).log
    assert np.diff(found.t) == pytest.approx(1.0) and np.isnan(found.y[1::2]).all() and np.isfinite(found.y[::2]).all()
