"""Forward-backward contraction loses no solution."""

from __future__ import annotations

import numpy as np
import pytest
from set_inversion import EQUATIONS, meets, target_of

from fusion_sfdia.derivatives.intervals.contractors import PROJECTIONS, backward
from fusion_sfdia.derivatives.intervals.expression import DOMAINS, record
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.interval_kernels import KERNELS


@pytest.mark.parametrize("name", EQUATIONS)
def test_a_contractor_never_loses_a_solution(name: str) -> None:
    rng = np.random.default_rng(2)
    middle, radius = rng.uniform(-3, 3, (2, 300)), rng.uniform(0.01, 2, (2, 300))
    boxes = [Interval(m - r, m + r) for m, r in zip(middle, radius, strict=True)]
    expression = record(EQUATIONS[name], 2)
    targets = target_of(name)
    left = backward(expression, expression.evaluate(boxes), list(targets) if name == "two" else [targets])
    for _ in range(50):
        points = np.stack([rng.uniform(x.lo, x.hi) for x in boxes], axis=-1)
        solution = meets(name, points)
        assert np.all(left[0].contains(points[:, 0])[solution])
        assert np.all(left[1].contains(points[:, 1])[solution])
    assert all(np.all(box.contains(x)) for box, x in zip(boxes, left, strict=True))


def test_every_function_has_its_projection() -> None:
    assert set(PROJECTIONS) == set(KERNELS)
    assert set(DOMAINS) <= set(KERNELS)
