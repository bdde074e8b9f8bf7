"""Set inversion: inner boxes lie in the set, the set lies in the outer boxes, contraction loses nothing, budgets are kept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from set_inversion import EQUATIONS, covered, meets, ring, samples, target_of

from fusion_sfdia.derivatives.intervals.expression import record
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.sivia import Paving, sivia

RING_AREA = 3 * np.pi


def assert_same(one: Paving, problem: int, many: Paving) -> None:
    """A problem of a batch has the bits that it has alone."""
    place = np.unravel_index(problem, many.complete.shape)
    np.testing.assert_array_equal([one.hull.lo, one.hull.hi], [many.hull.lo[place], many.hull.hi[place]])
    for name in ("inner", "boundary"):
        here = getattr(many, f"{name}_problem") == problem
        alone, among = getattr(one, name), getattr(many, name)[here]
        np.testing.assert_array_equal([alone.lo, alone.hi], [among.lo, among.hi])
    assert one.complete == many.complete[place]
    assert one.examined == many.examined[place]
    assert one.inner_volume == many.inner_volume[place]


@pytest.mark.parametrize("contract", [False, True])
def test_the_ring(contract: bool) -> None:
    """Its area is between those of both pavings, and so is each sample."""
    box = Interval([-3.0, -3.0], [3.0, 3.0])
    paving = sivia(ring, Interval(1.0, 4.0), box, 0.05, contract=contract)
    assert paving.complete
    assert paving.inner_volume < RING_AREA < paving.outer_volume
    points = samples(box, 5000, 1)
    in_set = (ring(*points.T) >= 1) & (ring(*points.T) <= 4)
    outer = Interval.unchecked(
        *(np.concatenate([getattr(b, e) for b in (paving.inner, paving.boundary)]) for e in ("lo", "hi"))
    )
    assert np.all(in_set[covered(points, paving.inner)])
    assert np.all(covered(points[in_set], outer))
    assert np.all(paving.hull.contains(points[in_set]))
    assert np.all(paving.boundary.width <= 0.05)


def test_the_ring_by_bisection_has_the_areas_of_the_dyadic_grid() -> None:
    """Boxes of side 6/128: counted over the grid: a box is inside when its nearest and farthest corners are."""
    paving = sivia(ring, Interval(1.0, 4.0), Interval([-3.0, -3.0], [3.0, 3.0]), 0.05, contract=False)
    edge = np.linspace(-3, 3, 129)
    near = np.maximum(np.maximum(edge[:-1], -edge[1:]), 0) ** 2
    far = np.maximum(edge[1:], -edge[:-1]) ** 2
    least, greatest = near[:, None] + near, far[:, None] + far
    cell = (6 / 128) ** 2
    inner = np.sum((least >= 1) & (greatest <= 4)) * cell
    assert paving.inner_volume == pytest.approx(inner, rel=1e-12)
    assert (
        abs(paving.outer_volume - np.sum((least <= 4) & (greatest >= 1)) * cell) <= 16 * cell
    )  # corners that touch the circles
    np.testing.assert_allclose([paving.inner_volume, paving.outer_volume], [8.859, 9.984], atol=5e-4)


def test_contraction_sharpens_both_sides_for_fewer_boxes() -> None:
    box = Interval([-3.0, -3.0], [3.0, 3.0])
    plain, sharp = (sivia(ring, Interval(1.0, 4.0), box, 0.05, contract=c) for c in (False, True))
    assert plain.inner_volume < sharp.inner_volume < sharp.outer_volume < plain.outer_volume
    assert sharp.examined < plain.examined


@pytest.mark.parametrize("contract", [False, True])
@pytest.mark.parametrize("name", EQUATIONS)
def test_pavings_enclose_from_both_sides(name: str, contract: bool) -> None:
    """Equations that are not defined everywhere in the box too: where there is no value there is no solution."""
    box = Interval([-3.0, -3.0], [3.0, 3.0])
    paving = sivia(EQUATIONS[name], target_of(name), box, 0.2, contract=contract)
    points = samples(box, 3000, 3)
    solution = meets(name, points)
    in_inner, in_boundary = covered(points, paving.inner), covered(points, paving.boundary)
    assert solution.any()
    assert np.all(solution[in_inner])
    assert np.all((in_inner | in_boundary)[solution])


def test_no_box_counts_as_inner_where_the_function_has_no_value() -> None:
    for contract in (False, True):
        paving = sivia(lambda x: np.sqrt(x), Interval(-1.0, 5.0), Interval([-1.0], [1.0]), 0.01, contract=contract)
        assert np.all(paving.inner.lo >= 0)
        assert paving.inner_volume <= 1


@pytest.mark.parametrize("contract", [False, True])
def test_a_batch_of_problems_is_a_loop_to_the_bit(contract: bool) -> None:
    def weighted(x: Any, y: Any, a: Any) -> Any:
        return a * x**2 + np.exp(y / a)

    rng = np.random.default_rng(4)
    middle = rng.uniform(0.5, 2, (2, 3))
    low = rng.uniform(-3, -1, (2, 3, 2))
    box, a = Interval(low, low + 4), Interval(middle, middle + 0.05)
    target = Interval(1.0, rng.uniform(1.2, 3, (2, 3)))
    many = sivia(weighted, target, box, [0.1, 0.2], parameters=[a], budget=300, contract=contract)
    assert many.complete.shape == (2, 3)
    for k, (i, j) in enumerate(np.ndindex(2, 3)):
        one = sivia(weighted, target[i, j], box[i, j], [0.1, 0.2], parameters=[a[i, j]], budget=300, contract=contract)
        assert_same(one, k, many)


def test_parameters_within_bounds() -> None:
    """x p in [1, 2], p in [1, 1.25]: some p admits x in [0.8, 2], every p admits x in [1, 1.6]."""
    paving = sivia(lambda x, p: x * p, Interval(1.0, 2.0), Interval([0.0], [5.0]), 1e-3, parameters=[Interval(1.0, 1.25)])
    np.testing.assert_allclose([paving.hull.lo[0], paving.hull.hi[0]], [0.8, 2.0], atol=1e-3)
    np.testing.assert_allclose([paving.inner.lo.min(), paving.inner.hi.max()], [1.0, 1.6], atol=1e-3)
    assert paving.hull.contains([[0.8], [2.0]]).all()
    assert paving.inner.lo.min() >= 1 - 1e-12  # outward rounding
    assert paving.inner.hi.max() <= 1.6


def test_a_parity_relation_is_solved_for_its_unknown() -> None:
    """0 = z - sqrt(a / b): readings with bounds give the bounds of the algebraic variable."""
    a, b = Interval(4.0, 9.0), Interval(1.0, 4.0)
    paving = sivia(lambda z, a, b: z - np.sqrt(a / b), Interval(0.0), Interval([0.0], [100.0]), 1e-6, parameters=[a, b])
    np.testing.assert_allclose([paving.hull.lo[0], paving.hull.hi[0]], [1.0, 3.0], atol=1e-6)
    assert paving.hull.contains([[1.0], [3.0]]).all()


@pytest.mark.parametrize("contract", [False, True])
def test_a_budget_is_kept_and_its_end_is_reported(contract: bool) -> None:
    box = Interval([-3.0, -3.0], [3.0, 3.0])
    points = samples(box, 3000, 5)
    solution = points[(ring(*points.T) >= 1) & (ring(*points.T) <= 4)]
    for budget in (1, 2, 3, 10, 100, 1000):
        paving = sivia(ring, Interval(1.0, 4.0), box, 1e-3, budget=budget, contract=contract)
        assert not paving.complete
        assert paving.examined <= budget
        assert np.all(covered(solution, paving.inner) | covered(solution, paving.boundary))
        assert paving.inner_volume <= RING_AREA <= paving.outer_volume


def test_an_empty_result_proves_that_there_is_no_solution() -> None:
    for contract in (False, True):
        paving = sivia(ring, Interval([-2.0, 1.0], [-1.0, 4.0]), Interval([-3.0, -3.0], [3.0, 3.0]), 0.5, contract=contract)
        np.testing.assert_array_equal(paving.is_empty, [True, False])
        np.testing.assert_array_equal(paving.complete, [True, True])
        assert paving.outer_volume[0] == 0
        assert paving.hull.is_empty[0].all()
    certain = sivia(ring, Interval(0.0, 100.0), Interval([-3.0, -3.0], [3.0, 3.0]), 0.5)
    just_enough = sivia(ring, Interval(0.0, 100.0), Interval([-3.0, -3.0], [3.0, 3.0]), 0.5, budget=1)
    assert certain.inner_volume == just_enough.inner_volume == 36 and just_enough.complete
    assert certain.examined == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tolerance": 0.0}, "tolerance is 0.0; expected a positive width"),
        ({"tolerance": [0.1, 0.1, 0.1]}, "for each of 2 variables"),
        ({"tolerance": np.nan}, "positive width"),
        ({"budget": 0}, "budget is 0"),
        ({"box": Interval(-3.0, 3.0)}, "variables on the last axis"),
        ({"box": Interval([-3.0] * 3, [3.0] * 3)}, "does not run on 3"),
        ({"box": Interval([-np.inf, 0.0], [3.0, 3.0])}, "empty or infinite"),
        ({"box": Interval.empty((2,))}, "empty or infinite"),
        ({"target": [Interval(0.0, 1.0)] * 2}, "2 targets for 1 results"),
        ({"parameters": [np.nan]}, "does not|NaN"),
        ({"function": lambda x, y: x + np.array([1.0, 2.0]) * y}, "pass it as an argument"),
        ({"function": lambda x, y: x if x > 0 else y}, "greater is not available"),
        ({"function": record(ring, 2), "box": Interval([0.0] * 3, [1.0] * 3)}, "2 arguments, the box and its parameters 3"),
    ],
)
def test_bad_input_is_rejected(change: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"function": ring, "target": Interval(1.0, 4.0), "box": Interval([-3.0, -3.0], [3.0, 3.0])}
    with pytest.raises(ValueError, match=message):
        sivia(**(given | {"tolerance": 0.1} | change))


def test_a_gap_without_values_inside_a_box_is_no_part_of_the_set() -> None:
    """sqrt(x^2 - 1) has values at both ends of [-2, 2] and none between -1 and 1."""
    paving = sivia(lambda x: np.sqrt(x**2 - 1), Interval(-1.0, 5.0), Interval([-2.0], [2.0]), 0.01)
    assert not np.any((paving.inner.lo < 1) & (paving.inner.hi > -1))
    assert 1.9 < paving.inner_volume <= 2 <= paving.outer_volume < 2.1


def test_what_is_cut_off_on_several_sides_counts_once() -> None:
    """min(x, y) <= 1/2 in the unit square: all but the upper right quarter."""
    paving = sivia(lambda x, y: np.minimum(x, y), Interval(-1.0, 0.5), Interval([0.0, 0.0], [1.0, 1.0]), 0.01)
    assert 0.74 < paving.inner_volume <= 0.75 <= paving.outer_volume < 0.76


def test_a_target_without_an_upper_end() -> None:
    paving = sivia(lambda x: 2 * x, Interval(1.0, np.inf), Interval([0.0], [1.0]), 0.01)
    np.testing.assert_allclose([paving.inner_volume, paving.outer_volume], 0.5, atol=0.01)
    assert paving.inner_volume <= 0.5 <= paving.outer_volume
