"""Nested tuples of arrays are taken apart and put together in one place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from fusion_sfdia.detectors.state import Array, State, chosen_runs, joined_runs, leaves, mapped, names, rebuilt


class Inner(NamedTuple):
    """Of two arrays."""

    p: Array
    q: Array


class Outer(NamedTuple):
    """An array, a named tuple, and a tuple of arrays alike."""

    a: Array
    inner: Inner
    rules: tuple[Array, ...]


def outer(runs: int, start: float = 0.0) -> Outer:
    a, p, q, r, s = (start + 100.0 * k + np.arange(runs) for k in range(5))
    return Outer(a, Inner(p, np.stack([q, -q], axis=-1)), (r, s))


def state(runs: int, start: float = 0.0) -> State:
    diverged, far = start + np.arange(runs) > 1, np.arange(runs) - 1
    return State(np.array(3, np.uint64), np.array(7), np.array(1.5), diverged, far, outer(runs, start))


def test_arrays_have_the_names_of_their_fields_in_one_order() -> None:
    tree = outer(2)
    assert names(tree) == ["a", "inner.p", "inner.q", "rules.0", "rules.1"]
    assert [a.tolist() for a in leaves(tree)] == [[0, 1], [100, 101], [[200, -200], [201, -201]], [300, 301], [400, 401]]
    again = rebuilt(tree, leaves(tree))
    assert type(again) is Outer and type(again.inner) is Inner and type(again.rules) is tuple
    assert all(a is b for a, b in zip(leaves(again), leaves(tree), strict=True))


def test_a_function_is_applied_to_arrays_at_the_same_place() -> None:
    found = mapped(lambda a, b: a + b, outer(2), outer(2, start=1.0))
    assert type(found) is Outer and type(found.inner) is Inner
    np.testing.assert_array_equal(found.inner.p, [201, 203])
    np.testing.assert_array_equal(found.inner.q, [[401, -401], [403, -403]])


def test_runs_are_chosen_and_joined_with_their_clock_as_it_is() -> None:
    some = chosen_runs(state(4), np.array([3, 1]))
    assert (some.seed, some.steps, some.t) == (3, 7, 1.5)
    assert some.diverged.tolist() == [True, False] and some.memory.inner.p.tolist() == [103, 101]
    both = joined_runs(some, chosen_runs(state(4), np.array([0])))
    assert (both.seed, both.steps, both.t) == (3, 7, 1.5)
    assert both.diverged.tolist() == [True, False, False] and both.memory.rules[1].tolist() == [403, 401, 400]


def test_tuples_of_other_lengths_do_not_pass_silently() -> None:
    with pytest.raises(ValueError, match="shorter"):
        mapped(np.add, outer(1), outer(1).inner)
