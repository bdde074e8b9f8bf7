"""The IEEE 1788 test vectors of ITF1788: a result encloses the tightest one, a few units in the last place away."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.derivatives.intervals.contractors import PROJECTIONS, base, factor
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.interval_kernels import real_power
from fusion_sfdia.derivatives.intervals.rounding import LIBRARY_ULPS

# + - * / sqrt: the nearest float lies within one unit of the tightest bound and goes out by one, near underflow by two
ROUNDED = 2
# library functions: wrong by LIBRARY_ULPS, then out by LIBRARY_ULPS + 1 units of 2^-52 |x|, each up to two of x's units
LIBRARY = LIBRARY_ULPS + 2 * (LIBRARY_ULPS + 1) + 2
LINE = Interval(-np.inf, np.inf)


def restricted_power(x: Interval, y: Interval) -> Interval:
    """The standard's pow has no negative base; `**` takes one where the exponent is whole."""
    with np.errstate(all="ignore"):
        return Interval.unchecked(*real_power((x.lo, x.hi), (y.lo, y.hi)))


INTERVALS: dict[str, tuple[str, Callable[..., Interval], int]] = {
    "pos": ("elem", np.positive, 0),
    "neg": ("elem", np.negative, 0),
    "abs": ("elem", np.abs, 0),
    "min": ("elem", np.minimum, 0),
    "max": ("elem", np.maximum, 0),
    "add": ("elem", np.add, ROUNDED),
    "sub": ("elem", np.subtract, ROUNDED),
    "mul": ("elem", np.multiply, ROUNDED),
    "div": ("elem", np.divide, ROUNDED),
    "recip": ("elem", np.reciprocal, ROUNDED),
    "sqr": ("elem", np.square, ROUNDED),
    "sqrt": ("elem", np.sqrt, ROUNDED),
    "pown": ("elem", np.power, LIBRARY),
    "pow": ("elem", restricted_power, LIBRARY),
    "exp": ("elem", np.exp, LIBRARY),
    "log": ("elem", np.log, LIBRARY),
    "log10": ("elem", np.log10, LIBRARY),
    "tanh": ("elem", np.tanh, LIBRARY),
    "atanh": ("elem", np.arctanh, LIBRARY),
    "sin": ("elem", np.sin, LIBRARY),
    "cos": ("elem", np.cos, LIBRARY),
    "intersection": ("set", Interval.intersection, 0),
    "convexHull": ("set", Interval.hull, 0),
}


def number(text: str) -> float:
    return float.fromhex(text) if "0x" in text.lower() else float(text)


def value(token: str) -> Any:
    """An interval [a, b], a number, or a truth value."""
    if token in ("true", "false"):
        return token == "true"
    if not token.startswith("["):
        return number(token)
    inside = token[1:-1].lower()
    if inside == "empty":
        return Interval.empty()
    if inside == "entire":
        return Interval(-np.inf, np.inf)
    ends = [number(end) for end in inside.split(",")]
    return Interval(ends[0], ends[-1])


def vectors(folder: Path, file: str, operation: str) -> list[tuple[list[Any], Any]]:
    """Arguments and result of each undecorated vector of an operation."""
    text = re.sub(r"/\*.*?\*/|//[^\n]*", "", (folder / "itf1788" / f"libieeep1788_{file}.itl").read_text(), flags=re.DOTALL)
    found = []
    for left, right in re.findall(rf"^\s*{operation}\s+([^;=]*)=([^;]*);", text, flags=re.MULTILINE):
        if "_" in left or "nai" in left:  # decorated intervals and "not an interval" are no part of this arithmetic
            continue
        arguments, results = ([value(t) for t in re.findall(r"\[[^\]]*\]|[^\s\[\]]+", side)] for side in (left, right))
        found.append((arguments, results[0]))
    assert found, f"no vector of {operation}"
    return found


def place(x: float) -> int:
    """Number of a float in the order of all floats: neighbours differ by one."""
    bits = int(np.float64(x).view(np.int64))
    return bits if bits >= 0 else -(bits & (2**63 - 1))


def check(name: str, given: list[Any], result: Interval, tightest: Interval, ulps: int) -> None:
    case = f"{name} {given}: {result!r}, tightest {tightest!r}"
    assert bool(result.is_empty) == bool(tightest.is_empty), case
    if not tightest.is_empty:
        assert result.contains(tightest), case
        assert place(tightest.lo) - place(result.lo) <= ulps, case
        assert place(result.hi) - place(tightest.hi) <= ulps, case


@pytest.mark.parametrize("name", INTERVALS)
def test_operation(shared_fixtures: Path, name: str) -> None:
    file, operation, ulps = INTERVALS[name]
    for given, tightest in vectors(shared_fixtures, file, name):
        check(name, given, operation(*given), tightest, ulps)


REVERSE: dict[str, Callable[..., Any]] = {
    "sqrRev": lambda z, x=LINE: PROJECTIONS[np.square][0](z, x),
    "absRev": lambda z, x=LINE: PROJECTIONS[np.absolute][0](z, x),
    "pownRev": lambda z, n: base(z, LINE, Interval(n)),
    "pownRevBin": lambda z, x, n: base(z, x, Interval(n)),
    "mulRev": lambda y, z, x=LINE: factor(z, x, y),
}
REVERSE |= {"sqrRevBin": REVERSE["sqrRev"], "absRevBin": REVERSE["absRev"], "mulRevTen": REVERSE["mulRev"]}


@pytest.mark.parametrize("name", REVERSE)
def test_projection(shared_fixtures: Path, name: str) -> None:
    """Roots are powers with the exponent [1/n] a unit wide on each side, so a root x is off by 2 |log x| units more."""
    for given, tightest in vectors(shared_fixtures, "rev", name):
        logs = [abs(np.log(abs(e))) for e in (tightest.lo, tightest.hi) if np.isfinite(e) and e != 0]
        check(name, given, REVERSE[name](*given), tightest, LIBRARY + int(4 * max(logs, default=0)))


@pytest.mark.parametrize("name", ["mid", "wid", "rad"])
def test_number(shared_fixtures: Path, name: str) -> None:
    attribute = {"mid": "mid", "wid": "width", "rad": "radius"}[name]
    for (x,), expected in vectors(shared_fixtures, "num", name):
        got = float(getattr(x, attribute))
        if np.isnan(expected):
            assert np.isnan(got)
        else:  # the middle is rounded twice, width and radius up by one unit
            assert abs(place(got) - place(expected)) <= ROUNDED, f"{name} {x}: {got}, {expected}"
            assert name == "mid" or got >= expected


def test_truth(shared_fixtures: Path) -> None:
    for (x,), expected in vectors(shared_fixtures, "bool", "isEmpty"):
        assert bool(x.is_empty) is expected
    for (x, y), expected in vectors(shared_fixtures, "bool", "subset"):
        assert bool(y.contains(x)) is expected, f"{x} subset of {y}"
