"""Which sensors explain residuals: small cases that are checked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.stochastic_thresholds.bias_hypotheses import Evidence, explain


@pytest.mark.parametrize(
    ("before", "now", "late", "low", "high"),
    [
        (0.0, 7.0, False, 4.0, 10.0),  # it begins now, with all of its size
        (10.0, 7.0, True, 7.0, 13.0),  # a step ago: 1 then, 1 - M + L = 0.7 now
        (6.25, 6.25, True, 5.2, 14.8),  # long ago: (1 - M) / (1 - L) = 0.625 at both
    ],
)
def test_a_fault_that_began_before_now_is_late(before: float, now: float, late: bool, low: float, high: float) -> None:
    """A residual with the part M = 0.5 of the last reading and L = 0.2 of the last residual, thresholds of 3."""
    said = (Evidence(np.array([[z]]), np.ones((1, 1)), np.full((1, 1), 3.0)) for z in (before, now))
    found = explain(*said, np.array([[[0.5]]]), np.array([[[0.2]]]), np.array([[True]]))
    assert found.named.all() and bool(found.late[0, 0]) is late
    assert (found.low[0, 0], found.high[0, 0]) == pytest.approx((low, high))
    assert found.size[0, 0] == pytest.approx({0.0: 7.0}.get(before, 10.0))
