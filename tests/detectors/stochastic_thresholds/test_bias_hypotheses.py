"""Which sensors explain residuals: small cases that are checked by hand, and plain loops over sensors and hypotheses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from fusion_sfdia.detectors.stochastic_thresholds.bias_hypotheses import StepResiduals, explain

Array = np.ndarray


class Fault(NamedTuple):
    """A hypothesis of a sensor that explains its reach: interval, size, log-likelihood ratio (twice), begun before now."""

    low: float
    high: float
    size: float
    gain: float
    late: bool


def best_faults(i: int, steps: list[tuple[Array, Array, Array]], M: Array, L: Array) -> list[Fault]:
    """The best of the three hypotheses of sensor i as the module's docstring states them, on one run; more where they tie."""
    one = np.eye(len(M))
    lasting = (np.linalg.inv(one - L) @ (one - M))[:, i]
    found = []
    for late, shares in enumerate([(0 * one[i], one[i]), (one[i], (one - M + L)[:, i]), (lasting, lasting)]):
        low, high, square, product = -np.inf, np.inf, 0.0, 0.0
        for share, (residual, deviation, threshold) in zip(shares, steps, strict=True):
            for j in range(len(M)):
                if not (j == i or M[j, i] or L[j, i]) or np.isnan(residual[j]) or np.isinf(threshold[j]):
                    continue
                if share[j] == 0.0:
                    low, high = (low, high) if abs(residual[j]) <= threshold[j] else (np.inf, -np.inf)
                else:
                    ends = (residual[j] - threshold[j]) / share[j], (residual[j] + threshold[j]) / share[j]
                    low, high = max(low, min(ends)), min(high, max(ends))
                square += (share[j] / deviation[j]) ** 2
                product += share[j] * residual[j] / deviation[j] ** 2
        if low <= high and not low <= 0 <= high:
            size = min(max(product / square, low), high)
            found.append(Fault(low, high, size, 2 * size * product - size**2 * square, late > 0))
    most = max((fault.gain for fault in found), default=0.0)
    return [fault for fault in found if fault.gain >= most - 1e-9 * abs(most)]


def test_explanations_equal_those_of_plain_loops() -> None:
    """Two groups of three sensors that share nothing; residuals of one fault, or of one in each group, with noise and gaps."""
    rng, runs, groups = np.random.default_rng(8), 400, np.repeat([0, 1], 3)
    together = groups[:, None] == groups
    M, L = (np.where(together & (rng.random((runs, 6, 6)) < 0.5), rng.uniform(-0.4, 0.4, (runs, 6, 6)), 0.0) for _ in range(2))
    one, suspects = np.eye(6), rng.random((runs, 6)) < 0.9
    lasting = np.linalg.solve(one - L, one - M)
    hypotheses = (0 * lasting, one + 0 * lasting), (one + 0 * lasting, one - M + L), (lasting, lasting)
    deviation, threshold = rng.uniform(0.5, 2.0, (2, runs, 6)), rng.uniform(2.0, 6.0, (2, runs, 6))
    residual = threshold * rng.uniform(-0.6, 0.6, (2, runs, 6))
    for r in range(runs):
        for i in (rng.integers(3), 3 + rng.integers(3))[: 1 + r % 2]:
            shares = hypotheses[rng.integers(3)]
            residual[:, r] += rng.choice([-1, 1]) * rng.uniform(3.0, 15.0) * np.stack([s[r, :, i] for s in shares])
    residual[rng.random(residual.shape) < 0.05] = np.nan
    threshold[rng.random(threshold.shape) < 0.05] = np.inf
    steps = [(residual[k], deviation[k], threshold[k]) for k in (0, 1)]
    found = explain(*(StepResiduals(*step) for step in steps), M, L, suspects)
    explained = late = pairs = 0
    for r in range(runs):
        faults = [best_faults(i, [tuple(a[r] for a in step) for step in steps], M[r], L[r]) for i in range(6)]
        reach = (one != 0) | (M[r] != 0) | (L[r] != 0)
        left = {i: fault for i, fault in enumerate(faults) if fault and suspects[r, i]}
        for i, fault in left.items():
            given = (found.low[r, i], found.high[r, i], found.size[r, i])
            assert any(given == pytest.approx(f[:3], rel=1e-9) and found.late[r, i] == f.late for f in fault), (r, i)
            explained, late = explained + 1, late + fault[0].late
        named = set()
        while left:
            best = max(left, key=lambda i: left[i][0].gain)
            named.add(best)
            left = {i: fault for i, fault in left.items() if not np.any(reach[:, i] & reach[:, best])}
        assert set(np.flatnonzero(found.isolated[r])) == named, r
        pairs += len(named) > 1
    assert explained - late > 30 and late > 100 and pairs > 30


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
    said = (StepResiduals(np.array([[z]]), np.ones((1, 1)), np.full((1, 1), 3.0)) for z in (before, now))
    found = explain(*said, np.array([[[0.5]]]), np.array([[[0.2]]]), np.array([[True]]))
    assert found.isolated.all() and bool(found.late[0, 0]) is late
    assert (found.low[0, 0], found.high[0, 0]) == pytest.approx((low, high))
    assert found.size[0, 0] == pytest.approx({0.0: 7.0}.get(before, 10.0))
