"""Ranks: a difference where there is one, none where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.benchmarks.comparison_ranking import holm, paired_p, ranking


def test_holm_is_step_down_and_keeps_the_order() -> None:
    # by hand: 0.01 x 3, max(0.03, 0.02 x 2), max(0.04, 0.5)
    np.testing.assert_allclose(holm([0.5, 0.01, 0.02]), [0.5, 0.03, 0.04])
    assert holm([]).size == 0
    assert holm([0.9, 0.8]).max() <= 1.0


def test_equal_values_do_not_differ() -> None:
    values = np.random.default_rng(0).uniform(size=30)
    found = ranking({"a": values, "b": values.copy(), "c": values.copy()})
    assert {s.rank for s in found.values()} == {1}
    assert found["a"].alike == ("b", "c")
    assert paired_p(np.zeros(5)) == 1.0


def test_a_shift_of_every_pair_decides_and_ranks() -> None:
    rng = np.random.default_rng(1)
    base = rng.uniform(size=40)
    found = ranking({"low": base, "high": base + 0.1 + 0.01 * rng.uniform(size=40), "mid": base + 0.05})
    assert {name: s.rank for name, s in found.items()} == {"high": 1, "mid": 2, "low": 3}
    assert found["high"].mean.n == 40


def test_chance_rarely_ranks() -> None:
    rng = np.random.default_rng(2)
    trials = 200
    wrong = 0
    for _ in range(trials):
        values = {name: rng.standard_normal(25) for name in "abcd"}
        wrong += any(s.rank > 1 for s in ranking(values).values())
    # family-wise error at most 0.05: beyond 0.05 + 3 standard errors of 200 trials it is not kept
    assert wrong / trials <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / trials)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_clusters_show_nothing(count: int) -> None:
    found = ranking({"a": np.ones(count), "b": np.zeros(count)})
    assert {s.rank for s in found.values()} == {1}
