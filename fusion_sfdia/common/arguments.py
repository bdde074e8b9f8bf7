"""Arguments of callers: converted where their meaning is unambiguous, otherwise refused with the argument's name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import date, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def shown(value: object) -> str:
    """The value as an error shows it, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def some(names: Sequence[str]) -> str:
    """The first names, each cut to a length that a line can hold."""
    first = ", ".join(repr(n if len(n) <= 20 else f"{n[:20]}...") for n in names[:8])
    return f"{first} and {len(names) - 8} more" if len(names) > 8 else first


def number(what: str, value: object) -> float:
    """Return a real number as a float, NaN and infinities too; ValueError for text, None, truth values and arrays."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool | np.timedelta64) or not isinstance(value, float | int | np.floating | np.integer):
        raise ValueError(f"{what} is {shown(value)}; expected a number")
    return float(value)


def whole(what: str, value: object, least: int) -> int:
    """Return an integer of at least `least`; ValueError for anything else, 2.0 too."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool | np.timedelta64) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{what} is {shown(value)}; expected a whole number of at least {least}")
    return int(value)


def probability(what: str, value: object) -> float:
    """Return a number strictly between 0 and 1; ValueError for anything else."""
    if not 0 < (p := number(what, value)) < 1:
        raise ValueError(f"{what} is {value}; expected a probability strictly between 0 and 1")
    return p


def floats(what: str, value: Any) -> Array:
    """Return an array, or nested lists of numbers, as an array of floats; None and masked entries become NaN.

    ValueError for text, complex numbers, dates (their numbers would be in nanoseconds or the like), and rows of different
    lengths.
    """
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    cure = ""
    try:
        given = np.asarray(value)
        if _dated(given):
            cure = "; pass dates as seconds since the first, (t - t[0]) / np.timedelta64(1, 's')"
        elif isinstance(value, np.ma.MaskedArray):
            return np.ma.filled(value.astype(float), np.nan)
        elif given.dtype.kind in "biufO":
            return given.astype(float)
    except (TypeError, ValueError):
        pass
    raise ValueError(f"{what} is {shown(value)}; expected an array of numbers{cure}")


def _dated(given: Array) -> bool:
    """Whether an array holds dates or durations, of NumPy, pandas or the standard library."""
    first = given.flat[0] if given.dtype.kind == "O" and given.size else None
    return given.dtype.kind in "Mm" or isinstance(first, date | timedelta | np.datetime64 | np.timedelta64)


def batch_shape(batch: object) -> tuple[int, ...]:
    """Return the shape of a batch given as such or, where it has one axis, as its length; ValueError for anything else."""
    given = batch if isinstance(batch, tuple | list) else (batch,)
    if any(isinstance(b, bool) or not isinstance(b, int | np.integer) or b < 0 for b in given):
        raise ValueError(f"batch is {shown(batch)}; expected a shape: () for a single run, (3,) or 3 for three runs")
    return tuple(int(b) for b in given)


def require_unique(what: str, names: Sequence[str]) -> None:
    """Raise ValueError where a name occurs twice."""
    twice = sorted(n for n, count in Counter(names).items() if count > 1)
    if twice:
        raise ValueError(f"{what}: the names {', '.join(twice)} occur more than once; names must differ")


def require_names(where: str, found: Iterable[str], known: Iterable[str]) -> None:
    """Raise ValueError for a name that is not known."""
    if unknown := [name for name in found if name not in (known := tuple(known))]:
        raise ValueError(f"{where} unknown name {unknown[0]!r}; known: {', '.join(known)}")
