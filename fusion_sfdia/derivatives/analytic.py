"""Which functions in a model are not analytic, and where they stand: the complex step is wrong there, or has a kink.

The model is evaluated once on arrays that remember the functions that their values come from. A result that depends on |x| is
found even where the branch with |x| is not taken at these values, as in np.where(x > 2, abs(x - 2), 0), which evaluates
both. Not found is what compiled code, np.asarray or a Python `if` hides; there only a comparison with differences helps.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

WRONG, REFUSED, KINK = "wrong", "refused", "kink"  # of the complex step: a wrong derivative, an error, that of one side
LEFT_OUT = "leave it out of the model: its derivative is 0 or undefined (the resolution of a sensor belongs to its noise)"
MEET = "correct on both sides; make both branches and their slopes meet where operation crosses"
COMPARISONS = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal", "isclose")
EFFECTS: dict[str, tuple[str, str]] = {
    "absolute": (WRONG, "write np.where(x < 0, -x, x) in place of abs(x)"),
    "sign": (WRONG, "write np.where(x < 0, -1.0, 1.0) in place of np.sign(x)"),
    "real": (WRONG, "leave .real out, or use it in comparisons only"),
    "imag": (WRONG, "leave .imag out, or use it in comparisons only"),
    "conjugate": (WRONG, "leave the conjugate out: states are real"),
    "angle": (WRONG, "write the angle with np.arctan, without a complex number"),
    "round": (WRONG, LEFT_OUT),
    "astype": (WRONG, "leave the conversion out: states are numbers of any kind"),
    "fabs": (REFUSED, "write np.where(x < 0, -x, x) in place of np.fabs(x)"),
    "hypot": (REFUSED, "write np.sqrt(a**2 + b**2) in place of np.hypot(a, b)"),
    "arctan2": (REFUSED, "write np.arctan(a / b) in place of np.arctan2(a, b) where b > 0"),
    "interp": (REFUSED, "fit a polynomial (np.polyval) in place of np.interp, whose slope jumps at each point of its table"),
    "copysign": (REFUSED, "write np.where(y < 0, -x, x)"),
    "heaviside": (REFUSED, "write np.where(x < 0, 0.0, 1.0)"),
    **dict.fromkeys(
        ("floor", "ceil", "trunc", "rint", "floor_divide", "remainder", "fmod", "fix", "digitize"), (REFUSED, LEFT_OUT)
    ),
    **dict.fromkeys(
        ("maximum", "minimum", "fmax", "fmin", "clip", "max", "min", "amax", "amin"),
        (KINK, "correct beside the kink; where operation crosses it, round it off: 0.5 * (x + np.sqrt(x**2 + small**2))"),
    ),
    **dict.fromkeys(
        ("where", "select", "piecewise", "searchsorted", "argmax", "argmin", "sort", "median", "percentile"),
        (KINK, MEET),
    ),
    **dict.fromkeys(COMPARISONS, (KINK, MEET)),
}  # fmt: skip
OWN = Path(__file__).name


class Use(NamedTuple):
    """A function that is not analytic: its name in numpy, its place (file:line), and what the complex step does with it."""

    name: str
    place: str

    @property
    def effect(self) -> str:
        """One of WRONG, REFUSED and KINK."""
        return EFFECTS[self.name][0]

    @property
    def cure(self) -> str:
        """What to write instead."""
        return EFFECTS[self.name][1]

    def __str__(self) -> str:
        return f"{'abs' if self.name == 'absolute' else self.name} ({self.place})"


def non_analytic(function: Callable[[Array], Array], x: Array) -> tuple[Use, ...]:
    """The functions that are not analytic and on which function(x) depends, by their places; empty where it fails."""
    with np.errstate(all="ignore"):
        try:
            found = function(_traced(np.array(x, dtype=float), frozenset()))
        except Exception:  # of a function that takes plain arrays only
            return ()
    return tuple(sorted(_uses(found), key=lambda use: (use.place, use.name)))


class _Traced(np.ndarray[Any, Any]):
    """An array with the `uses` that its values come from."""

    uses: frozenset[Use]

    def __array_finalize__(self, other: Any) -> None:
        self.uses = getattr(other, "uses", frozenset())

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, out: Any = None, **options: Any) -> Any:
        if out is not None:
            options["out"] = tuple(map(_plain, out))
        uses = _of(ufunc.__name__, _uses(inputs) | _uses(options.get("where")))
        result = getattr(ufunc, method)(*map(_plain, inputs), **{k: _plain(v) for k, v in options.items()})
        if out is not None:
            for array in out:
                if isinstance(array, _Traced):
                    array.uses = uses
            return out[0] if len(out) == 1 else out
        return _wrapped(result, uses)

    def __array_function__(self, function: Any, types: Iterable[type], given: Any, options: Any) -> Any:
        uses = _of(function.__name__, _uses(given) | _uses(tuple(options.values())))
        if function.__name__ == "copyto" and isinstance(given[0], _Traced):
            given[0].uses = uses
        return _wrapped(function(*map(_plain, given), **{k: _plain(v) for k, v in options.items()}), uses)

    def __setitem__(self, where: Any, value: Any) -> None:
        self.uses = self.uses | _uses((where, value))
        self.view(np.ndarray)[_plain(where)] = _plain(value)

    def __getitem__(self, where: Any) -> Any:
        return _wrapped(self.view(np.ndarray)[_plain(where)], self.uses | _uses(where))

    @property  # type: ignore[misc]  # only read here
    def real(self) -> Any:
        return _traced(self.view(np.ndarray).real, _of("real", self.uses))

    @property  # type: ignore[misc]
    def imag(self) -> Any:
        return _traced(self.view(np.ndarray).imag, _of("imag", self.uses))

    def conj(self) -> Any:
        return np.conjugate(self)

    conjugate = conj

    def round(self, *given: Any, **options: Any) -> Any:
        return _traced(self.view(np.ndarray).round(*given, **options), _of("round", self.uses))

    def clip(self, *given: Any, **options: Any) -> Any:
        return _traced(self.view(np.ndarray).clip(*map(_plain, given), **options), _of("clip", self.uses))

    def astype(self, dtype: Any, *given: Any, **options: Any) -> Any:
        uses = self.uses if np.issubdtype(dtype, np.complexfloating) or self.dtype == bool else _of("astype", self.uses)
        return _traced(self.view(np.ndarray).astype(dtype, *given, **options), uses)


def _of(name: str, uses: frozenset[Use]) -> frozenset[Use]:
    """The uses of a result of a function: a comparison does not pass on |x|, which then only decides, with a kink."""
    if name in COMPARISONS:
        uses = frozenset(use for use in uses if use.effect == KINK)
    return uses | {Use(name, _place())} if name in EFFECTS else uses


def _place() -> str:
    """File and line of the caller outside of numpy and this module."""
    frame: Any = sys._getframe(2)
    while frame.f_back and (Path(frame.f_code.co_filename).name == OWN or "numpy" in Path(frame.f_code.co_filename).parts):
        frame = frame.f_back
    return f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"


def _traced(array: Array, uses: frozenset[Use]) -> _Traced:
    found = array.view(_Traced)
    found.uses = uses
    return found


def _wrapped(result: Any, uses: frozenset[Use]) -> Any:
    if isinstance(result, tuple | list):
        return type(result)(_wrapped(part, uses) for part in result)
    return _traced(np.asarray(result), uses) if isinstance(result, np.ndarray | np.generic) else result


def _plain(value: Any) -> Any:
    if isinstance(value, _Traced):
        return value.view(np.ndarray)
    return type(value)(map(_plain, value)) if type(value) in (tuple, list) else value


def _uses(value: Any) -> frozenset[Use]:
    if isinstance(value, _Traced):
        return value.uses
    return frozenset().union(*map(_uses, value)) if type(value) in (tuple, list) else frozenset()
