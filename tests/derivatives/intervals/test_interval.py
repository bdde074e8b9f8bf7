"""Interval arrays: they contain the results of their members, on samples and to the last place, in any batch."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.derivatives.intervals.interval import Interval, select
from fusion_sfdia.derivatives.intervals.rounding import LIBRARY_ULPS

Function = Callable[..., Any]
UNARY: list[tuple[str, Function]] = [
    ("-x", lambda x: -x),
    ("abs", abs),
    ("square", np.square),
    ("reciprocal", np.reciprocal),
    ("sqrt", np.sqrt),
    ("exp", np.exp),
    ("expm1", np.expm1),
    ("log", np.log),
    ("log10", np.log10),
    ("log1p", np.log1p),
    ("tanh", np.tanh),
    ("arctanh", np.arctanh),
    ("sin", np.sin),
    ("cos", np.cos),
    *((f"power {n}", lambda x, n=n: x**n) for n in (-3, -2, -1, 0, 1, 2, 3, 4, 7, 0.5, 1.4, -0.3)),
    ("2^x", lambda x: 2.0**x),
]
BINARY: list[tuple[str, Function]] = [
    ("+", lambda x, y: x + y),
    ("-", lambda x, y: x - y),
    ("*", lambda x, y: x * y),
    ("/", lambda x, y: x / y),
    ("minimum", np.minimum),
    ("maximum", np.maximum),
    ("x^y", lambda x, y: abs(x) ** y),
]


def intervals(rng: np.random.Generator, shape: tuple[int, ...]) -> Interval:
    """Around zero and away from it, wide, narrow and points, over many orders of magnitude."""
    middle = rng.normal(size=shape) * 10.0 ** rng.integers(-3, 3, shape)
    radius = np.abs(middle) * rng.choice([0.0, 1e-15, 1e-3, 1.0, 3.0], shape)
    return Interval(middle - radius, middle + radius)


def members(rng: np.random.Generator, x: Interval, n: int) -> np.ndarray:
    """n values of each interval, its ends among them: (n, ...)."""
    share = rng.uniform(size=(n, *x.shape))
    share[0], share[1] = 0.0, 1.0
    return np.clip(x.lo + share * (x.hi - x.lo), x.lo, x.hi)


def assert_encloses(result: Interval, values: np.ndarray) -> None:
    """Up to the rounding of the sample itself, as float results are; samples outside the domain have no value."""
    slack = 4 * (LIBRARY_ULPS + 1) * np.finfo(float).eps * np.abs(values)  # a sample of one library function may be off by this
    with np.errstate(invalid="ignore"):
        ok = (result.lo <= values + slack) & (values - slack <= result.hi)
    assert np.all(ok | ~np.isfinite(values))


@pytest.mark.parametrize(("name", "function"), UNARY, ids=[name for name, _ in UNARY])
def test_a_function_of_an_interval_contains_that_of_its_members(name: str, function: Function) -> None:
    rng = np.random.default_rng(1)
    x = intervals(rng, (2000,))
    with np.errstate(all="ignore"):
        values = function(members(rng, x, 30))
    assert_encloses(function(x), values)
    assert np.all(~np.isfinite(values).any(axis=0) | ~function(x).is_empty)


@pytest.mark.parametrize(("name", "function"), BINARY, ids=[name for name, _ in BINARY])
def test_an_operation_on_intervals_contains_that_on_their_members(name: str, function: Function) -> None:
    rng = np.random.default_rng(2)
    x, y = intervals(rng, (2000,)), intervals(rng, (2000,))
    with np.errstate(all="ignore"):
        assert_encloses(function(x, y), function(members(rng, x, 30), members(rng, y, 30)))
        assert_encloses(function(x, 2.5), function(members(rng, x, 30), 2.5))
        assert_encloses(function(np.float64(-0.3), y), function(-0.3, members(rng, y, 30)))


@pytest.mark.parametrize(("name", "function"), UNARY + BINARY, ids=[name for name, _ in UNARY + BINARY])
def test_a_smaller_interval_gives_a_smaller_result(name: str, function: Function) -> None:
    rng = np.random.default_rng(3)
    count = 2 if (name, function) in BINARY else 1
    wide = [intervals(rng, (2000,)) for _ in range(count)]
    narrow = []
    for x in wide:
        ends = np.sort(members(rng, x, 4)[2:], axis=0)
        narrow.append(Interval(ends[0], ends[1]))
    assert np.all(function(*wide).contains(function(*narrow)))


@pytest.mark.parametrize(("name", "function"), UNARY + BINARY, ids=[name for name, _ in UNARY + BINARY])
def test_a_batch_is_a_loop_to_the_bit(name: str, function: Function) -> None:
    rng = np.random.default_rng(4)
    arguments = [intervals(rng, (7, 30)) for _ in range(2 if (name, function) in BINARY else 1)]
    arguments[0] = select(rng.uniform(size=(7, 30)) < 0.1, Interval.empty(), arguments[0])
    whole = function(*arguments)
    for i in range(7):
        for j in range(30):
            one = function(*(x[i, j] for x in arguments))
            np.testing.assert_array_equal([one.lo, one.hi], [whole.lo[i, j], whole.hi[i, j]])


def to_decimal(name: str, x: Decimal, y: Decimal) -> Decimal:
    return {
        "+": lambda: x + y,
        "*": lambda: x * y,
        "/": lambda: x / y,
        "sqrt": lambda: abs(x).sqrt(),
        "exp": lambda: x.exp(),
        "expm1": lambda: x.exp() - 1,
        "log": lambda: abs(x).ln(),
        "log1p": lambda: (1 + abs(x)).ln(),
        "log10": lambda: abs(x).log10(),
        "tanh": lambda: ((2 * x).exp() - 1) / ((2 * x).exp() + 1),
        "power": lambda: (y * abs(x).ln()).exp(),
        "cube": lambda: x * x * x,
    }[name]()


EXACT: list[tuple[str, Function, float]] = [
    ("+", lambda x, y: x + y, 2),
    ("*", lambda x, y: x * y, 2),
    ("/", lambda x, y: x / y, 2),
    ("sqrt", lambda x, y: np.sqrt(abs(x)), 2),
    ("exp", lambda x, y: np.exp(x), 0),
    ("expm1", lambda x, y: np.expm1(x), 0),
    ("log", lambda x, y: np.log(abs(x)), 0),
    ("log1p", lambda x, y: np.log1p(abs(x)), 0),
    ("log10", lambda x, y: np.log10(abs(x)), 0),
    ("tanh", lambda x, y: np.tanh(x), 0),
    ("power", lambda x, y: abs(x) ** y, 0),
    ("cube", lambda x, y: x**3, 0),
]


@pytest.mark.parametrize(("name", "function", "ulps"), EXACT, ids=[name for name, _, _ in EXACT])
def test_points_contain_the_exact_value(name: str, function: Function, ulps: float) -> None:
    """Against decimal arithmetic of 60 digits. Rounded operations are at most 2 x 2 units wide; library functions are off by
    at most LIBRARY_ULPS on each side and go out by LIBRARY_ULPS + 1 more, units that count double just above a power of two."""
    ulps = ulps or 2 * (LIBRARY_ULPS + 1)
    rng = np.random.default_rng(5)
    size = 10.0 ** rng.integers(-8, 2, (2, 1500))
    x, y = rng.normal(size=(2, 1500)) * size
    result = function(Interval(x), Interval(y))
    with localcontext() as context:
        context.prec = 60
        for i in range(x.size):
            exact = to_decimal(name, Decimal(x[i]), Decimal(y[i]))
            assert Decimal(result.lo[i]) <= exact <= Decimal(result.hi[i]), f"{name} of {x[i]!r}, {y[i]!r}"
    assert np.all(result.width <= 2 * (ulps + 1) * np.spacing(np.abs(result.hi)) + 1e-300)


def test_outward_rounding_checked_by_hand() -> None:
    tenth = Interval(0.1) + Interval(0.2)
    assert tenth.lo < 0.1 + 0.2 < tenth.hi
    assert tenth.width <= 3 * np.spacing(0.3)
    top = np.finfo(float).max
    assert (Interval(top) + Interval(top)).hi == np.inf
    assert (Interval(top) + Interval(top)).lo >= np.nextafter(top, 0)
    small = Interval(5e-324) * Interval(0.1)
    assert small.lo == 0
    assert small.hi > 0


def test_divisors_that_contain_zero() -> None:
    one = Interval(1.0, 2.0)
    for divisor, lo, hi in [((0, 4), 0.25, np.inf), ((-4, 0), -np.inf, -0.25), ((-1, 4), -np.inf, np.inf)]:
        got = one / Interval(*divisor)
        np.testing.assert_allclose([got.lo, got.hi], [lo, hi], rtol=1e-15)
        assert got.contains(Interval(lo, hi))
    assert (one / 0.0).is_empty
    zero = Interval(0.0) / Interval(-1.0, 1.0)
    assert (zero.lo, zero.hi) == (0, 0)


def test_domains() -> None:
    assert np.sqrt(Interval(-1.0, 4.0)).contains([0.0, 1.0, 2.0]).all()
    assert np.sqrt(Interval(-1.0, 4.0)).lo == 0
    assert np.sqrt(Interval(-2.0, -1.0)).is_empty
    assert np.log(Interval(-1.0, 1.0)).lo == -np.inf
    assert np.log(Interval(-1.0, 0.0)).is_empty
    assert np.arctanh(Interval(1.0, 2.0)).is_empty
    assert (Interval(-2.0, -1.0) ** 0.5).is_empty
    assert (Interval(-2.0, -1.0) ** 2.0).contains([1.0, 4.0]).all()


def test_sets() -> None:
    x, y = Interval([0.0, 0.0], [1.0, 1.0]), Interval([0.5, 2.0], [3.0, 3.0])
    both = x.intersection(y)
    np.testing.assert_array_equal(both.is_empty, [False, True])
    np.testing.assert_array_equal(both.lo, [0.5, np.nan])
    np.testing.assert_array_equal(x.hull(Interval.empty((2,))).hi, x.hi)
    np.testing.assert_array_equal(x.hull(y).hi, [3, 3])
    assert np.all(x.contains(both))
    assert not Interval.empty().contains(0.0)
    assert (both + 1.0).is_empty[1]
    assert np.exp(both).is_empty[1]
    assert (both**0).is_empty[1]
    left, right = x.bisect()
    np.testing.assert_array_equal(left.hi, right.lo)
    np.testing.assert_array_equal(x.mid, [0.5, 0.5])
    assert np.all(x.width >= 1)
    assert repr(Interval.empty()) == "Interval.empty()"
    box = Interval.stack([x[0], y[1]])
    np.testing.assert_array_equal([box.lo, box.hi], [[0, 2], [1, 3]])


def test_adding_in_place_binds_a_new_interval() -> None:
    x = y = Interval(1.0, 2.0)
    x += 1
    assert y.hi == 2
    assert x.contains(3.0)


@pytest.mark.parametrize(
    ("lo", "hi", "message"),
    [
        ([0.0, 3.0], [1.0, 2.0], r"lower bound 3.0 above upper bound 2.0 \(1 of 2\): swap them"),
        (np.nan, 1.0, "NaN; give a missing value its physical range"),
        (np.inf, np.inf, "expected lower bound below inf"),
    ],
)
def test_wrong_bounds_are_rejected(lo: Any, hi: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Interval(lo, hi)


def test_unsupported_operations_are_rejected() -> None:
    x = Interval(0.0, 1.0)
    with pytest.raises(TypeError, match="does not compare"):
        _ = x < 0.5
    with pytest.raises(TypeError, match="not an array"):
        np.where(True, x, 0.0)
    with pytest.raises(TypeError, match=r"intervals have no add\.reduce"):
        np.add.reduce(x)
    with pytest.raises(ValueError, match="missing value"):
        _ = np.array([np.nan]) + x
