"""The rank of a limit that a fresh value exceeds at a stated rate."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.common.order_statistics import exceedance_rank, order_statistic


@pytest.mark.parametrize(
    ("count", "rate", "rank"),
    [(99, 0.05, 95), (19, 0.05, 19), (18, 0.05, 19), (9, 0.5, 5), (9, 0.1, 9), (999, 1e-3, 999), (100, 0.05, 96)],
)
def test_the_rank_is_the_next_whole_number(count: int, rate: float, rank: int) -> None:
    """ceil((count + 1) (1 - rate)); rounding does not pass a whole number, as of 20 * 0.95."""
    assert exceedance_rank(count, rate) == rank


def test_the_value_of_that_rank_and_the_largest_where_there_are_too_few() -> None:
    values = np.stack([np.arange(9.0)[::-1], np.arange(9.0) * 10], axis=1)
    np.testing.assert_array_equal(order_statistic(values, 0.5), [4.0, 40.0])
    np.testing.assert_array_equal(order_statistic(values, 0.01), [8.0, 80.0])
