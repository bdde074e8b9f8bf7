"""Interval arrays: enclosures of the results of an equation for all values within bounds, including rounding errors.

    x = Interval(2.0, 3.0)
    np.sqrt(x) * (1 - x**2)  # an Interval that contains the result for every number in [2, 3]

Bounds are float arrays; a batch is leading axes, which are broadcast. NumPy's operators and elementwise functions
take intervals (`interval_kernels.KERNELS` lists which), alone and mixed with numbers and arrays, so they can be
passed to the equations of the physics. A literal stands for its nearest float.

The empty set is NaN, NaN: no solution, or no value in the domain. An operation on it returns the empty set. A missing reading
is not the empty set but its physical range, so NaN is rejected as a bound; `Interval.empty` makes an empty interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import ArrayLike, NDArray

from fusion_sfdia.derivatives.intervals import interval_kernels as kernels
from fusion_sfdia.derivatives.intervals.rounding import MAX, above, rounds_to_nearest

Array = NDArray[Any]


class Interval(NDArrayOperatorsMixin):
    """Closed intervals [lo, hi] of any shape; without `hi`, points.

    Raises ValueError where lo > hi, a bound is NaN, lo is +inf or hi is -inf.
    """

    __slots__ = ("hi", "lo")
    lo: Array
    hi: Array

    def __init__(self, lo: ArrayLike, hi: ArrayLike | None = None) -> None:
        low = np.asarray(lo, dtype=float)
        if hi is None:
            high = low  # the same array twice: so the kernels recognise a point
        else:
            low, high = np.broadcast_arrays(low, np.asarray(hi, dtype=float))
        if (np.isnan(low) | np.isnan(high)).any():
            raise ValueError(
                "a bound is NaN; give a missing value its physical range, or use Interval.empty(shape) for the empty set"
            )
        if (wrong := low > high).any():
            raise ValueError(
                f"lower bound {low[wrong][0]} above upper bound {high[wrong][0]} ({np.sum(wrong)} of {wrong.size}): "
                "swap them, or use Interval.empty(shape) if no value is possible"
            )
        if ((low == np.inf) | (high == -np.inf)).any():
            raise ValueError("lower bound inf or upper bound -inf; expected lower bound below inf, upper bound above -inf")
        self.lo, self.hi = low, high

    @classmethod
    def unchecked(cls, lo: Array, hi: Array) -> Interval:
        """An interval from bounds that a kernel returned, without checks; NaN, NaN is the empty set."""
        made = cls.__new__(cls)
        made.lo, made.hi = lo, hi
        return made

    @classmethod
    def empty(cls, shape: tuple[int, ...] = ()) -> Interval:
        return cls.unchecked(np.full(shape, np.nan), np.full(shape, np.nan))

    @classmethod
    def stack(cls, intervals: Sequence[Interval], axis: int = -1) -> Interval:
        """Return a box from its components, which are broadcast against each other."""
        lo = np.stack(np.broadcast_arrays(*(x.lo for x in intervals)), axis)
        return cls.unchecked(lo, np.stack(np.broadcast_arrays(*(x.hi for x in intervals)), axis))

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if not all(isinstance(x, Interval | int | float | np.number | np.ndarray) for x in inputs):
            return NotImplemented
        if kwargs.get("out") == (inputs[0],):  # x += y, which binds x to a new interval
            del kwargs["out"]
        if method != "__call__" or kwargs or ufunc not in kernels.KERNELS:
            raise TypeError(
                f"intervals have no {ufunc.__name__}{'' if method == '__call__' else '.' + method}; an equation does not "
                f"compare values and uses {', '.join(sorted(f.__name__ for f in kernels.KERNELS))}"
            )
        if not rounds_to_nearest():
            raise RuntimeError(
                "the processor does not round to nearest, so no bound would hold: a library changed the mode (codac does "
                "when imported; call it through fusion_sfdia.derivatives.intervals.codac_adapter) and has to restore it"
            )
        arguments = [x if isinstance(x, Interval) else Interval(x) for x in inputs]
        with np.errstate(all="ignore"):
            return Interval.unchecked(*kernels.KERNELS[ufunc](*((x.lo, x.hi) for x in arguments)))

    def __array__(self, *_: Any, **__: Any) -> Array:
        raise TypeError("an Interval is not an array: use .lo, .hi or .mid")

    def __getitem__(self, key: Any) -> Interval:
        return Interval.unchecked(self.lo[key], self.hi[key])

    def __repr__(self) -> str:
        if self.shape:
            return f"Interval({self.lo!r}, {self.hi!r})"
        return "Interval.empty()" if self.is_empty else f"Interval({self.lo:.17g}, {self.hi:.17g})"

    @property
    def shape(self) -> tuple[int, ...]:
        return self.lo.shape

    @property
    def is_empty(self) -> Array:
        return np.isnan(self.lo)

    @property
    def mid(self) -> Array:
        """A finite point of the interval: the middle, 0 for the real line, the largest float for a half-line; NaN for empty."""
        lo, hi = np.maximum(self.lo, -MAX), np.minimum(self.hi, MAX)
        middle = np.minimum(np.maximum(0.5 * lo + 0.5 * hi, lo), hi)
        upward, downward = np.isinf(self.hi), np.isinf(self.lo)
        return np.where(upward & ~downward, hi, np.where(downward & ~upward, lo, middle))

    @property
    def width(self) -> Array:
        """Upper minus lower bound, rounded upward; 0 for a point, NaN for empty."""
        with np.errstate(all="ignore"):
            return np.where(self.lo == self.hi, 0.0, above(self.hi - self.lo))

    @property
    def radius(self) -> Array:
        """The least float for which [mid - radius, mid + radius] contains the interval, to a unit in the last place."""
        with np.errstate(all="ignore"):
            half = np.maximum(self.hi - self.mid, self.mid - self.lo)
            return np.where(self.lo == self.hi, 0.0, above(half))

    def intersection(self, other: Interval) -> Interval:
        return Interval.unchecked(*kernels.intersection((self.lo, self.hi), (other.lo, other.hi)))

    def hull(self, other: Interval) -> Interval:
        """Return the least interval that contains both."""
        return Interval.unchecked(*kernels.hull((self.lo, self.hi), (other.lo, other.hi)))

    def contains(self, other: Interval | ArrayLike) -> Array:
        """Return whether the interval contains all of other (points or intervals); every interval contains the empty set."""
        if isinstance(other, Interval):
            return other.is_empty | ((self.lo <= other.lo) & (other.hi <= self.hi))
        return (self.lo <= np.asarray(other)) & (np.asarray(other) <= self.hi)

    def bisect(self) -> tuple[Interval, Interval]:
        """Return both halves, which share the midpoint."""
        middle = self.mid
        return Interval.unchecked(self.lo, middle), Interval.unchecked(middle, self.hi)


def select(condition: Array, yes: Interval, no: Interval) -> Interval:
    """`np.where` for intervals."""
    return Interval.unchecked(np.where(condition, yes.lo, no.lo), np.where(condition, yes.hi, no.hi))
