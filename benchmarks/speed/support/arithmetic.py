"""The arithmetic of a call, counted: multiply-adds of matrices, and other additions, multiplications, divisions and powers.

Matrices are counted as in `counting`. Of +, -, *, / and ** each that gives a floating-point number counts, and of one that
gives an array, its elements; of a += b the numbers of b. Index arithmetic gives integers and does not count. In modules that
are imported after `install` these operators are rewritten; compiled functions stay compiled, and are rewritten Python during a
counted call only, so that what prepares it takes its usual time.

Less is counted than is done: no comparisons, elementary functions, sums and other functions of NumPy, random numbers, nor what
other packages do; a factorisation by the usual method of the fewest operations, and of a dual number its value and its slope as
one operation each.
"""

from __future__ import annotations

import ast
import builtins
import inspect
from collections import Counter
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numba.core.dispatcher import Dispatcher

from fusion_sfdia.benchmarks.speed.support.counting import Products, count_matrices, counted_dot, multiply_adds

CALL = "__call__"
COUNTED = "_counted_number"  # the name of `_counted` in rewritten modules
OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow)
COMPILED = ("compiled", "python_first", "part", "equation")  # decorators of functions that are compiled
SINGLE, DOUBLE = 4, 8  # bytes of a number

_operations: Counter[int] = Counter()  # by the bytes of a number; complex ones count as one of double precision


class Arithmetic(NamedTuple):
    """Multiply-adds of matrices, and other operations, in double and in single precision."""

    products: int
    single_products: int
    operations: int
    single_operations: int


def arithmetic(call: Callable[[], object]) -> Arithmetic:
    """Count a call, in a process in which `install` was called."""
    multiply_adds.clear()
    _operations.clear()
    dot, np.dot = np.dot, counted_dot
    setattr(Dispatcher, CALL, _in_python)
    try:
        with np.errstate(all="ignore"):
            call()
    finally:
        delattr(Dispatcher, CALL)
        np.dot = dot
    return Arithmetic(multiply_adds[DOUBLE], multiply_adds[SINGLE], _operations[DOUBLE], _operations[SINGLE])


def install(package: str = "fusion_sfdia") -> None:
    """Count what the modules of the package do that are imported from now on, in this process, for good.

    RuntimeError where modules with numerical code of it are imported already.
    """
    count_matrices(package, _OutsideCompiled())
    setattr(builtins, COUNTED, _counted)


def _counted(value: Any) -> Any:
    if isinstance(value, float):
        _operations[DOUBLE] += 1
    elif isinstance(value, _Dual):
        _operations[DOUBLE] += 2
    elif isinstance(value, np.ndarray | np.inexact) and value.dtype.kind in "fc":
        _operations[min(value.dtype.itemsize, DOUBLE)] += value.size
    return value


def _in_python(function: Any, *arguments: Any) -> Any:
    return _rewritten(function.py_func)(*arguments)


@cache
def _rewritten(function: FunctionType) -> Any:
    """A compiled function, or a function that it calls, as Python in which arithmetic is counted."""
    tree = _Operators().visit(ast.parse(inspect.getsource(function)))
    tree.body[0].decorator_list = []
    tree.body[:0] = ast.parse("from __future__ import annotations").body
    package, names = function.__module__.partition(".")[0], dict(function.__globals__)
    for name in function.__code__.co_names:
        called = names.get(name)
        if getattr(called, "__name__", "") == "dual":
            names[name] = _Dual
        elif isinstance(called, FunctionType) and called.__module__.partition(".")[0] == package:
            names[name] = _rewritten(called)
    exec(compile(ast.fix_missing_locations(tree), inspect.getfile(function), "exec"), names)
    return names[function.__name__]


class _Dual:
    """A dual number outside compiled code (see `derivatives.dual`); NumPy finds its functions by their names."""

    __array_priority__ = 1.0  # above that of NumPy's numbers

    def __init__(self, value: float, slope: float = 0.0) -> None:
        self.value, self.slope = value, slope

    def __add__(self, other: Any) -> _Dual:
        b = _as_dual(other)
        return _Dual(self.value + b.value, self.slope + b.slope)

    def __mul__(self, other: Any) -> _Dual:
        b = _as_dual(other)
        return _Dual(self.value * b.value, self.slope * b.value + self.value * b.slope)

    def __truediv__(self, other: Any) -> _Dual:
        b = _as_dual(other)
        ratio = np.float64(self.value) / b.value
        return _Dual(ratio, (self.slope - ratio * b.slope) / b.value)

    def __pow__(self, by: float) -> _Dual:
        power = np.float64(self.value) ** by
        return _Dual(power, by * power / self.value * self.slope)

    def __neg__(self) -> _Dual:
        return _Dual(-self.value, -self.slope)

    def __sub__(self, other: Any) -> _Dual:
        return self + -_as_dual(other)

    def __rsub__(self, other: Any) -> _Dual:
        return _as_dual(other) - self

    def __rtruediv__(self, other: Any) -> _Dual:
        return _as_dual(other) / self

    def __ge__(self, other: Any) -> bool:
        return bool(self.value >= _as_dual(other).value)

    __radd__, __rmul__ = __add__, __mul__

    def log(self) -> _Dual:
        return _Dual(np.log(self.value), self.slope / self.value)

    def exp(self) -> _Dual:
        return _Dual(np.exp(self.value), np.exp(self.value) * self.slope)

    def sqrt(self) -> _Dual:
        return _Dual(np.sqrt(self.value), 0.5 * self.slope / np.sqrt(self.value))


def _as_dual(number: Any) -> _Dual:
    return number if isinstance(number, _Dual) else _Dual(number)


class _Operators(Products):
    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:  # noqa: N802
        found = super().visit_BinOp(node)
        return _call(node) if isinstance(node.op, OPERATORS) else found

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:  # noqa: N802
        self.generic_visit(node)
        if isinstance(node.op, OPERATORS):
            node.value = _call(node.value)
        return node


class _OutsideCompiled(_Operators):
    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:  # noqa: N802
        marked = any(isinstance(decorator, ast.Name) and decorator.id in COMPILED for decorator in node.decorator_list)
        return node if marked else self.generic_visit(node)


def _call(value: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(COUNTED, ast.Load()), [value], [])
