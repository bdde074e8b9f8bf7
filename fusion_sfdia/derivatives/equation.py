"""One source for each equation.

An equation is a plain function of scalars, written with operators and elementwise functions and without branching on
values. `@equation` leaves it an ordinary Python function, so it takes floats, NumPy batches, complex numbers and, where
its operations allow, intervals; compiled code may call it too, and then it is compiled into its caller.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from time import thread_time
from types import FunctionType
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from fusion_sfdia.derivatives.machine_code import MachineCode

F = TypeVar("F", bound=Callable[..., Any])
Array = NDArray[Any]

AS_PYTHON = 0.3  # s: some loops take a little less to compile, some more
LARGEST_CHANGE = 0.1  # of a deviation within a step
COMPLEX_STEP = 1e-30  # no subtraction takes place, so any size free of underflow gives the derivative to rounding


def equation(function: F) -> F:
    """Mark a scalar function as an equation: Python for arrays and complex numbers, compiled inside compiled callers.

    There it is always inlined; otherwise loops over it would not become vector instructions.

    Parameters
    ----------
    function : callable
        Of scalars, written with operators and elementwise functions and without branching on values.

    Returns
    -------
    callable
        The function itself.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.plants import equation
    >>> @equation
    ... def outflow(level, c):
    ...     return c * np.sqrt(level)
    >>> outflow(np.array([1.0, 4.0]), 0.5)
    array([0.5, 1. ])
    """
    return register_jitable(forceinline=True, no_cfunc_wrapper=True)(function)  # type: ignore[no-any-return]


def compiled(function: F) -> F:
    """Compile a loop over equations (a driver) and keep the machine code on disk.

    Numbers that change without an edit (fitted coefficients, parameters) are arguments. Where the code is kept: see
    `machine_code`.
    """
    found = njit(error_model="numpy", no_cfunc_wrapper=True)(function)
    with suppress(RuntimeError):  # numba finds no folder
        found._cache = MachineCode(function)
    return found  # type: ignore[no-any-return]


def python_first(function: F) -> F:
    """Compile a short loop once it has run as Python for as long as its compilation takes, or is on disk: with the same bits.

    For loops over readings in double precision, of single operations, square roots and functions of `math`: those of NumPy
    may round otherwise than compiled ones. Most are then never compiled for a log of a few hundred rows.
    """
    found: Any = compiled(function)
    found._compile_for_args = AsPython(found)
    return found  # type: ignore[no-any-return]


class AsPython:
    """What a dispatcher asks for code of arguments that are new to it: the function itself, for a while."""

    patient = True  # False: everything is compiled at once

    def __init__(self, dispatcher: Any) -> None:
        self.dispatcher, self.left, self.look = dispatcher, AS_PYTHON, AS_PYTHON
        self.function: Callable[..., Any] | None = None  # of Python alone, where it is needed

    def __call__(self, *args: Any) -> Any:
        if self.left <= self.look and self.dispatcher.stats.cache_path and self.dispatcher._cache.has_code:
            self.left = 0.0  # another process has compiled it, now or before
        if self.left <= 0 or not self.patient:
            return type(self.dispatcher)._compile_for_args(self.dispatcher, *args)
        self.look = min(self.look, self.left) - AS_PYTHON / 8
        return self.run

    def run(self, *args: Any) -> Any:
        self.function = self.function or _of_python(self.dispatcher)
        start = thread_time()
        with np.errstate(all="ignore"):
            found = self.function(*args)
        self.left -= thread_time() - start
        return found


def _of_python(dispatcher: Any) -> Callable[..., Any]:
    """The function without what numba makes of it, and of those that it calls."""
    function = dispatcher.py_func
    known = function.__globals__
    called = {n: _of_python(known[n]) for n in function.__code__.co_names if hasattr(known.get(n), "py_func")}
    return FunctionType(function.__code__, {**known, **called})


def part(function: F) -> F:
    """Mark a loop that compiled loops of the same file contain: its statements are copied into them before they are compiled.

    A loop compiled as a function of its own would be optimised again within each caller, which takes longer.
    """
    return njit(inline="always", error_model="numpy")(function)  # type: ignore[no-any-return]


def plain(a: Array) -> Array:
    """An array as compiled loops take it, contiguous floats: one type of arguments, so that nothing is compiled twice."""
    return a if a.flags.carray and a.dtype == np.float64 else np.array(a, dtype=float, order="C")


def batch_rows(a: Array, batch: tuple[int, ...], kind: Any, axes: int = 1) -> Array:
    """The batch of an array with so many axes of its own as (B, ..), contiguous and read only: one type, as of `plain`."""
    lead = a.ndim - axes
    whole = a if a.shape[:lead] == batch else np.broadcast_to(a, (*batch, *a.shape[lead:]))
    rows = np.ascontiguousarray(whole, dtype=kind).reshape(-1, *a.shape[lead:])
    rows.flags.writeable = False
    return rows


def argument_names(function: Callable[..., Any]) -> tuple[str, ...]:
    """Return the argument names of an equation: the variables it depends on, that is its row of the structure."""
    return tuple(inspect.signature(function).parameters)


def complex_step_jacobian(function: Callable[[Array], Array], x: Array) -> Array:
    """Return d function / d x, exact to rounding, by the complex step (Squire and Trapp 1998).

    `function` maps (..., n) to (..., m) elementwise over the leading axes and must be analytic (no abs, no
    comparison of the values); x is (..., n). The result is (..., m, n).
    """
    found: Array = function(x[..., None, :] + _perturbation(x.shape[-1])).imag / COMPLEX_STEP
    return found.swapaxes(-1, -2)


def with_complex_step(function: Callable[[Array], Array], x: Array) -> tuple[Array, Array] | None:
    """Return function(x) and d function / d x of `complex_step_jacobian` by one call, of x and its complex steps side by side.

    None where a value at x is not real or not finite, as that of a root of a negative number: the function is then to be called
    with real numbers, which show that they are outside its domain.
    """
    n = x.shape[-1]
    found: Array = function(x[..., None, :] + np.concatenate([np.zeros((1, n)), _perturbation(n)]))
    value = found[..., 0, :]
    if value.imag.any() or not np.isfinite(value.real).all():
        return None
    return value.real, (found[..., 1:, :].imag / COMPLEX_STEP).swapaxes(-1, -2)


@lru_cache
def _perturbation(n: int) -> Array:
    """A complex step of each of n variables, a row for each (n, n)."""
    return 1j * COMPLEX_STEP * np.eye(n)


def complex_step_holds(function: Callable[[Array], Array], x: Array, scale: Array) -> bool:
    """Whether the complex step agrees with central differences along one direction at each of the points x (B, n).

    It does not for abs, sign, interp and other functions that drop the imaginary part or reject complex numbers. With
    D(h) = (f(x + h d) - f(x - h d)) / 2h, the error of D(h/2) is (D(h/2) - D(h)) / 3 to leading order (Richardson) and
    rounding, of f and of x, over h; ten times their sum is allowed, so that a kink between the points passes. scale (n,) is
    the size of a change that matters, of which h = eps^(1/5) balances both. Values that are not finite do not count.
    """
    eps = np.finfo(float).eps
    h = eps ** (1 / 5)
    direction = scale * np.where(np.arange(scale.size) % 2, -1.0, 1.0) * np.linspace(0.5, 1.0, scale.size)
    with np.errstate(all="ignore"):
        ahead, behind, half_ahead, half_behind = (function(x + part * h * direction) for part in (1.0, -1.0, 0.5, -0.5))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", np.exceptions.ComplexWarning)
                exact = np.imag(function(x + 1j * COMPLEX_STEP * direction)) / COMPLEX_STEP
        except Exception:  # any error that a function of real numbers raises for complex ones
            return False
        wide, narrow = (ahead - behind) / (2 * h), (half_ahead - half_behind) / h
        steepness = np.max(np.abs(x / direction), axis=-1, keepdims=True)  # of f in x, where f changes by `narrow` over d
        rounding = eps / h * (np.maximum(np.abs(ahead), np.abs(behind)) + steepness * np.abs(narrow))
        sound = np.abs(exact - narrow) <= 10 * (np.abs(narrow - wide) / 3 + 4 * rounding)
    return bool(np.all(sound | ~np.isfinite(wide) | ~np.isfinite(narrow)))


def difference_jacobian(function: Callable[[Array], Array], x: Array, scale: Array) -> Array:
    """Return d function / d x by central differences of width eps^(1/3) scale, for functions that reject complex numbers.

    x is (..., n), scale (n,) the size of a change of each component that matters. The result is (..., m, n).
    """
    width = np.finfo(float).eps ** (1 / 3) * np.maximum(np.abs(scale), np.finfo(float).tiny)
    ahead = function(x[..., None, :] + np.diag(width))
    behind = function(x[..., None, :] - np.diag(width))
    return np.swapaxes((ahead - behind) / (2 * width[:, None]), -1, -2)


def step_of_change(rates: Array, scale: Array, dt: float) -> float:
    """The longest step (s) in which a deviation changes by a tenth, max(dt, 0.1 / |D^-1 A D|); dt where A is not finite.

    rates: A = df/dx (n, n) in 1/s; scale: diagonal of D (n,), of the states.
    """
    with np.errstate(all="ignore"):
        change = rates / scale[:, None] * scale
        if not np.all(np.isfinite(change)):
            return dt
        return float(np.maximum(dt, LARGEST_CHANGE / np.linalg.norm(change, 2)))
