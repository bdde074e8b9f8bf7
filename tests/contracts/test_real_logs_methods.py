"""The baselines of the page on recorded logs."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from rounding import rounding


@pytest.fixture
def methods(root: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(root / "docs" / "results"))
    return importlib.import_module("real_logs_methods")


def test_a_reading_less_its_expectation_is_that_of_its_regression_on_the_others_of_the_row(methods: ModuleType) -> None:
    rng = np.random.default_rng(0)
    a = rng.standard_normal((5, 5))
    cov, z = a @ a.T + np.eye(5), rng.standard_normal((4, 5))
    z[1, 2] = z[3, [0, 4]] = np.nan
    filled, error = methods._conditional(cov, z)
    for row, full, e in zip(z, filled, error, strict=True):
        for i in range(5):
            others = [j for j in np.flatnonzero(np.isfinite(row)).tolist() if j != i]
            weights = np.linalg.solve(cov[np.ix_(others, others)], cov[others, i])
            expected = weights @ row[others]
            tolerance = rounding(np.linalg.cond(cov), 25) * (1 + np.abs(row[others]).max())
            if np.isnan(row[i]):
                assert full[i] == pytest.approx(expected, abs=tolerance) and np.isnan(e[i])
            else:
                assert full[i] == row[i] and e[i] == pytest.approx(row[i] - expected, abs=tolerance)


def test_repeated_readings_are_counted_and_missing_ones_end_them(methods: ModuleType) -> None:
    y = np.array([[1.0, 2.0], [1.0, 3.0], [1.0, np.nan], [2.0, np.nan], [2.0, 3.0]])
    assert methods.equal(y).tolist() == [[1, 1], [2, 1], [3, 0], [1, 0], [2, 1]]


def test_the_last_reading_stands_for_missing_ones_for_a_few_rows(methods: ModuleType) -> None:
    z = np.full((8, 1), np.nan)
    z[1] = 5.0
    assert methods._held(z)[:, 0].tolist() == [0, 5, 5, 5, 5, 5, 0, 0]


def test_healthy_rows_are_cut_into_consecutive_blocks_of_runs_without_gaps(methods: ModuleType) -> None:
    t = np.concatenate([np.arange(20.0), 100 + np.arange(20.0)])
    log = methods.Log(t, np.column_stack([t, t**2]), np.zeros((40, 0)))
    scale = methods.Scale(np.array([0, 1]), np.full(2, np.nan), np.zeros(2), np.ones(2))
    blocks = methods.blocks_of([log, log], scale)
    assert len(blocks) == methods.BLOCKS and [len(z) for block in blocks for z in block] == [10] * 8
    assert np.concatenate([z[:, 0] for block in blocks for z in block]).tolist() == [*t, *t]
    assert sum(map(len, methods.without(blocks, 3))) == 70
