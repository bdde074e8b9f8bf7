"""Ranks: a difference where there is one, none where there is none."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from fusion_sfdia.study.comparison.ranking import holm, ranking, sign_flips


def test_holm_is_step_down_and_keeps_the_order() -> None:
    # by hand: 0.01 x 3, max(0.03, 0.02 x 2), max(0.04, 0.5)
    np.testing.assert_allclose(holm(np.array([0.5, 0.01, 0.02])), [0.5, 0.03, 0.04])
    assert holm(np.empty(0)).size == 0
    assert holm(np.array([0.9, 0.8])).max() <= 1.0


def test_equal_values_do_not_differ() -> None:
    values = np.random.default_rng(0).uniform(size=30)
    found = ranking({"a": values, "b": values.copy(), "c": values.copy()})
    assert {s.rank for s in found.values()} == {1}
    np.testing.assert_array_equal(sign_flips(np.zeros((2, 5))), 1.0)


def test_random_signs_are_counted_exactly() -> None:
    """All signs of few differences: of 2^8, two have a sum as large as eight equal ones."""
    rng = np.random.default_rng(3)
    differences = np.stack([np.ones(8), rng.standard_normal(8)])
    signs = np.array(list(product((-1.0, 1.0), repeat=8)))
    exact = np.mean(np.abs(signs @ differences.T) >= np.abs(differences.sum(axis=1)) - 1e-12, axis=0)
    # 20 000 draws: four standard errors
    np.testing.assert_allclose(sign_flips(differences), exact, atol=4 * np.sqrt(0.25 / 20_000))


def test_ranks_follow_the_means_that_are_shown() -> None:
    """One is a little better in most clusters and much worse in the others: signed ranks would say the contrary."""
    rng = np.random.default_rng(4)
    base = rng.uniform(size=60)
    change = np.where(np.arange(60) % 3 == 0, -0.5, 0.02)
    found = ranking({"often": base + change, "mean": base})
    assert found["mean"].rank == 1 and found["often"].rank == 2
    assert found["mean"].mean.value > found["often"].mean.value


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
