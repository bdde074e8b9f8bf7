"""Means over windows and errors of readings given all others: against conditional moments that are computed one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.learning.monitor.windows import (
    WindowSums,
    completed,
    errors,
    filled,
    patterns,
    precision_of,
    window_means,
    window_sums,
)

Array = NDArray[Any]

N = 5


@pytest.fixture(scope="module")
def covariance() -> Array:
    a = np.random.default_rng(0).standard_normal((2 * N, 2 * N))
    return a @ a.T + 0.5 * np.eye(2 * N)


def conditional(covariance: Array, row: Array, i: int, others: list[int]) -> tuple[float, float]:
    """The error of entry i given others, and its standard deviation."""
    c = covariance[i, others]
    g = np.linalg.solve(covariance[np.ix_(others, others)], c)
    return float(row[i] - g @ row[others]), float(np.sqrt(covariance[i, i] - g @ c))


def test_errors_are_those_of_conditional_means_with_and_without_the_own_past(covariance: Array) -> None:
    rng = np.random.default_rng(1)
    x = rng.multivariate_normal(np.zeros(2 * N), covariance, 60)
    x[rng.random(x.shape) < 0.15] = np.nan
    found = errors(np.linalg.inv(covariance), x, N)
    rounding = 100 * np.finfo(float).eps * np.linalg.cond(covariance)
    for k, row in enumerate(x):
        for i in range(N):
            if np.isnan(row[i]):
                assert np.isnan(found.level[k, i]) and np.isnan(found.change[k, i])
                continue
            known = [j for j in range(2 * N) if j != i and np.isfinite(row[j])]
            for values, own in ((found.change, [i + N]), (found.level, [])):
                others = [j for j in known if j != i + N or own]
                every = [j for j in range(2 * N) if j != i and (j != i + N or own)]
                error, sd = conditional(covariance, row, i, others)
                whole = conditional(covariance, np.zeros(2 * N), i, every)[1]
                assert values[k, i] == pytest.approx(error / sd * whole, abs=rounding)
                if not own:
                    assert found.wider[k, i] == pytest.approx(sd / whole, rel=rounding)


def test_missing_entries_are_completed_by_their_conditional_means(covariance: Array) -> None:
    x = np.random.default_rng(2).multivariate_normal(np.zeros(2 * N), covariance, 4)
    x[0, 3] = x[1, [0, 7]] = x[2, [0, 7]] = np.nan
    full = completed(np.linalg.inv(covariance), x)
    known = [j for j in range(2 * N) if j != 3]
    expected = covariance[3, known] @ np.linalg.solve(covariance[np.ix_(known, known)], x[0, known])
    assert full[0, 3] == pytest.approx(expected, rel=1e-9)
    assert np.array_equal(full[3], x[3]) and np.isfinite(full).all()
    assert [(rows.tolist(), m.tolist()) for rows, m in patterns(np.isnan(x))] == [([0], [3]), ([1, 2], [0, 7])] or len(
        list(patterns(np.isnan(x)))
    ) == 2


@pytest.mark.parametrize("w", [1, 4, 16, 64])
def test_a_mean_needs_half_of_the_rows_of_its_window_and_has_the_same_bits_in_any_piece_of_a_log(w: int) -> None:
    z = np.random.default_rng(3).standard_normal((300, 2))
    z[::3, 0] = np.nan
    found = window_means(z, w)
    for k in (max(w // 2 - 1, 0), w - 1, 200):
        part = z[max(k - w + 1, 0) : k + 1]
        enough = (np.sum(np.isfinite(part), axis=0) >= w / 2) & (k >= w - 1)
        assert np.array_equal(np.isfinite(found[k]), enough)
        assert found[k][enough] == pytest.approx(np.nanmean(part[:, enough], axis=0), abs=1e-12)
    assert np.array_equal(window_sums(np.nan_to_num(z), w)[100 + w :], window_sums(np.nan_to_num(z)[100:], w)[w:])


def test_moments_add_up_and_incomplete_rows_count_by_conditional_means(covariance: Array) -> None:
    rng = np.random.default_rng(4)
    x = rng.multivariate_normal(np.zeros(2 * N), covariance, 4000) + 3.0
    both = WindowSums.together([WindowSums.of(x[:1500]), WindowSums.of(x[1500:])])
    assert both.covariance(centred=True) == pytest.approx(np.cov(x.T, bias=True), abs=1e-9)
    assert both.mean == pytest.approx(x.mean(axis=0))
    x = x - 3.0
    gaps = x.copy()
    gaps[rng.random(x.shape) < 0.1] = np.nan  # a third of the rows is complete
    full = filled(gaps, 1e-6)
    # conditional means lack the conditional variance: at most that of the tenth of the entries that is missing
    full = full[np.isfinite(full).all(axis=1)]
    assert len(full) > 3900 and np.diag(WindowSums.of(full).covariance()) == pytest.approx(np.diag(covariance), rel=0.15)
    assert precision_of(covariance, 1.0) == pytest.approx(np.linalg.inv(covariance + np.eye(2 * N)))
