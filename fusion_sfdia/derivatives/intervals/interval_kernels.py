"""Interval arithmetic on bounds, rounded outward: one kernel for each NumPy ufunc.

A kernel maps bounds (lo, hi), two float arrays, to bounds. NaN, NaN is the empty set; a point may be given as the same array
twice (lo is hi), which saves half of the corners. The flavour is the set-based one of IEEE 1788: an argument is cut to the
domain of the function; where nothing remains the result is empty. Every result encloses the exact range, rounded outward by
`rounding`; sums and products that are exactly 0 stay 0.

Kernels expect floating-point warnings to be off, subnormal numbers to be on and rounding to nearest.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.intervals.rounding import EPS, HALF_ULP, LIBRARY_ULPS, MAX, above, below

Array = NDArray[Any]
Bounds = tuple[Array, Array]
Kernel = Callable[..., Bounds]


def is_empty(a: Bounds) -> Array:
    """Return where the bounds are NaN, NaN."""
    return np.isnan(a[0])


def emptied(a: Bounds, where: Array) -> Bounds:
    """Return the bounds, empty where `where` holds."""
    return (np.where(where, np.nan, a[0]), np.where(where, np.nan, a[1])) if where.any() else a


def intersection(a: Bounds, b: Bounds) -> Bounds:
    """Return the intersection of both."""
    lo, hi = np.maximum(a[0], b[0]), np.minimum(a[1], b[1])
    return emptied((lo, hi), lo > hi)


def hull(a: Bounds, b: Bounds) -> Bounds:
    """Return the least interval that contains both."""
    return np.fmin(a[0], b[0]), np.fmax(a[1], b[1])


def negative(a: Bounds) -> Bounds:
    """Return -a, exactly."""
    return -a[1], -a[0]


def add(a: Bounds, b: Bounds) -> Bounds:
    """Return a + b."""
    lo, hi = np.minimum(a[0] + b[0], MAX), np.maximum(a[1] + b[1], -MAX)
    return lo - np.abs(lo) * HALF_ULP, hi + np.abs(hi) * HALF_ULP  # no TINY: sums in the subnormal range are exact


def subtract(a: Bounds, b: Bounds) -> Bounds:
    """Return a - b."""
    return add(a, negative(b))


def corners(function: Callable[[Array, Array], Array], a: Bounds, b: Bounds) -> Bounds:
    """Return the least and greatest value at the corners.

    Undefined values (0 inf, 0/0, inf/inf) are left out: the neighbouring corners attain the ends of the range of limits there.
    """
    left, right = (x[:1] if x[0] is x[1] else x for x in (a, b))
    values = [function(x, y) for x in left for y in right]
    return reduce(np.fmin, values), reduce(np.fmax, values)


def outward_product(lo: Array, hi: Array, a: Bounds, b: Bounds) -> Bounds:
    """Round a product or quotient outward, without crossing zero where the signs of a and b determine its sign."""
    low, high = below(lo), above(hi)
    if not ((lo == 0) | (hi == 0)).any():
        return low, high
    a_pos, a_neg, b_pos, b_neg = a[0] >= 0, a[1] <= 0, b[0] >= 0, b[1] <= 0
    zero = (a_pos & a_neg) | (b_pos & b_neg)
    low = np.where(zero | ((lo == 0) & ((a_pos & b_pos) | (a_neg & b_neg))), lo, low)
    high = np.where(zero | ((hi == 0) & ((a_pos & b_neg) | (a_neg & b_pos))), hi, high)
    return low, high


def multiply(a: Bounds, b: Bounds) -> Bounds:
    """Return a b."""
    lo, hi = corners(np.multiply, a, b)
    if (undefined := np.isnan(lo)).any():  # {0} times the real line is {0}
        zero = undefined & ~is_empty(a) & ~is_empty(b)
        lo, hi = np.where(zero, 0.0, lo), np.where(zero, 0.0, hi)
    return outward_product(lo, hi, a, b)


def divide(a: Bounds, b: Bounds) -> Bounds:
    """Return a / b over the b that are not 0: a half-line or the whole line where b contains 0, empty where b = {0}."""
    if not ((b[0] <= 0) & (b[1] >= 0)).any():
        lo, hi = corners(np.divide, a, b)
        return outward_product(lo, hi, a, b)
    lo, hi = corners(np.divide, a, (b[0] + 0.0, -(0.0 - b[1])))  # an end at zero is approached from inside: +0, -0
    across = (b[0] < 0) & (b[1] > 0) & ~((a[0] == 0) & (a[1] == 0)) & ~is_empty(a)
    lo, hi = np.where(across, -np.inf, lo), np.where(across, np.inf, hi)
    return emptied(outward_product(lo, hi, a, b), (b[0] == 0) & (b[1] == 0))


def reciprocal(a: Bounds) -> Bounds:
    """Return 1 / a, as `divide` does."""
    one = np.ones(())
    return divide((one, one), a)


def absolute(a: Bounds) -> Bounds:
    """Return |a|, exactly."""
    return np.maximum(np.maximum(a[0], -a[1]), 0.0), np.maximum(-a[0], a[1])


def square(a: Bounds) -> Bounds:
    """Return a^2, tighter than a a."""
    a = absolute(a)
    return outward_product(a[0] * a[0], a[1] * a[1], a, a)


def integer_power(a: Bounds, n: int) -> Bounds:
    """Return a^n; for n < 0 over the a that are not 0."""
    if n == 0:
        one = np.where(is_empty(a), np.nan, 1.0)
        return one, one
    if n == 1:
        return a
    if n in (2, -1):
        return square(a) if n == 2 else reciprocal(a)
    odd = n % 2 == 1
    lo, hi = a if odd else absolute(a)
    if n < 0:
        lo, hi = -(0.0 - hi), lo + 0.0
    lo, hi = np.power(lo, float(n)), np.power(hi, float(n))
    low, high = below(lo, LIBRARY_ULPS), above(hi, LIBRARY_ULPS)
    low = np.where((a[0] >= 0) | (not odd), np.maximum(low, 0.0), low)
    high = np.where(odd & (a[1] <= 0), np.minimum(high, 0.0), high)
    if n > 0:
        return low, high
    across = odd & (a[0] < 0) & (a[1] > 0)
    low, high = np.where(across, -np.inf, low), np.where(across, np.inf, high)
    return emptied((low, high), (a[0] == 0) & (a[1] == 0))


def real_power(a: Bounds, b: Bounds) -> Bounds:
    """Return a^b = exp(b log a) over a > 0, and 0^b = 0 for b > 0."""
    if (a[0] <= 0).any():
        a = intersection(a, NON_NEGATIVE)
        a = (a[0] + 0.0, a[1] + 0.0)  # (-0)^-1 = -inf, (+0)^-1 = inf
    lo, hi = corners(np.power, a, b)
    lo, hi = np.maximum(below(lo, LIBRARY_ULPS), 0.0), above(hi, LIBRARY_ULPS)
    only_zero = a[1] == 0
    lo, hi = np.where(only_zero, 0.0, lo), np.where(only_zero, 0.0, hi)
    return emptied((lo, hi), is_empty(a) | is_empty(b) | (only_zero & (b[1] <= 0)))


def power(a: Bounds, b: Bounds) -> Bounds:
    """Return a^b: for an integer b the power of every a, as in NumPy; otherwise over a >= 0."""
    if b[0] is b[1] and b[0].ndim == 0:
        return integer_power(a, int(b[0])) if float(b[0]).is_integer() else real_power(a, b)
    whole = (b[0] == b[1]) & (b[0] == np.rint(b[0]))
    lo, hi = (x.copy() for x in np.broadcast_arrays(*real_power(a, b)))
    a_lo, a_hi, exponent, whole = np.broadcast_arrays(*a, b[0], whole)
    for n in np.unique(exponent[whole]):
        here = whole & (exponent == n)
        lo[here], hi[here] = integer_power((a_lo[here], a_hi[here]), int(n))
    return lo, hi


def increasing(
    function: Callable[[Array], Array],
    domain: tuple[float, float] = (-np.inf, np.inf),
    image: tuple[float, float] = (-np.inf, np.inf),
    ulps: int = LIBRARY_ULPS,
) -> Kernel:
    """Kernel of a function that increases over its domain; an end without a finite value is not part of the domain."""
    least, greatest = (np.asarray(float(x)) for x in domain)
    with np.errstate(all="ignore"):
        open_low, open_high = (np.isfinite(x) and not np.isfinite(function(x)) for x in (least, greatest))

    def kernel(a: Bounds) -> Bounds:
        lo, hi = a
        if least > -np.inf or greatest < np.inf:
            outside = (hi <= least if open_low else hi < least) | (lo >= greatest if open_high else lo > greatest)
            lo, hi = emptied((np.maximum(lo, least), np.minimum(hi, greatest)), outside)
        return np.maximum(below(function(lo), ulps), image[0]), np.minimum(above(function(hi), ulps), image[1])

    return kernel


def periodic(function: Callable[[Array], Array], crest: float) -> Kernel:
    """Kernel of sin or cos, with maxima at 2 pi (k + crest); an extremum that may be inside counts as inside."""

    def kernel(a: Bounds) -> Bounds:
        ends = function(a[0]), function(a[1])
        lo = np.maximum(below(np.minimum(*ends), LIBRARY_ULPS), -1.0)
        hi = np.minimum(above(np.maximum(*ends), LIBRARY_ULPS), 1.0)
        for shift, value in ((crest, 1.0), (crest + 0.5, -1.0)):
            turns = [x / (2 * np.pi) - shift for x in a]
            margin = [4 * EPS * (np.abs(x) + 2) for x in turns]  # three roundings and the one of pi, half an EPS each
            inside = ~(np.ceil(turns[0] - margin[0]) > np.floor(turns[1] + margin[1])) & ~is_empty(a)  # true for inf - inf
            lo, hi = (np.where(inside, -1.0, lo), hi) if value < 0 else (lo, np.where(inside, 1.0, hi))
        infinite = np.isinf(a[0]) | np.isinf(a[1])
        return np.where(infinite, -1.0, lo), np.where(infinite, 1.0, hi)

    return kernel


def both(function: Callable[[Array, Array], Array]) -> Kernel:
    """Kernel of a function that increases in both arguments and is exact."""
    return lambda a, b: (function(a[0], b[0]), function(a[1], b[1]))


NON_NEGATIVE: Bounds = (np.zeros(()), np.full((), np.inf))
KERNELS: dict[np.ufunc, Kernel] = {
    np.positive: lambda a: a,
    np.negative: negative,
    np.add: add,
    np.subtract: subtract,
    np.multiply: multiply,
    np.divide: divide,
    np.reciprocal: reciprocal,
    np.power: power,
    np.square: square,
    np.absolute: absolute,
    np.minimum: both(np.minimum),
    np.maximum: both(np.maximum),
    np.sqrt: increasing(np.sqrt, (0, np.inf), (0, np.inf), ulps=0),
    np.exp: increasing(np.exp, image=(0, np.inf)),
    np.expm1: increasing(np.expm1, image=(-1, np.inf)),
    np.log: increasing(np.log, (0, np.inf)),
    np.log10: increasing(np.log10, (0, np.inf)),
    np.log1p: increasing(np.log1p, (-1, np.inf)),
    np.tanh: increasing(np.tanh, image=(-1, 1)),
    np.arctanh: increasing(np.arctanh, (-1, 1)),
    np.sin: periodic(np.sin, 0.25),
    np.cos: periodic(np.cos, 0.0),
}
