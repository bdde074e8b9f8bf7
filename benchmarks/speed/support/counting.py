"""How much a call does, counted: the same on every machine, however busy.

`counted` interprets a call instruction by instruction and counts

- `python`: instructions of Python outside of compiled functions, which grow where a loop over sensors or seeds replaced arrays;
- `operations`: instructions inside compiled functions, which `install` leaves as the Python that they are written in, elements
  of new arrays, and multiply-adds of matrix products and factorisations;
- `memory`: the largest number of bytes allocated at a time.

They grow with the size of a problem as its time and memory do. `install` has to be called in a process of its own before the
modules that are counted are imported. What it cannot see: the work inside other C functions, beyond the arrays they return.
"""

from __future__ import annotations

import ast
import builtins
import math
import operator
import sys
import tracemalloc
from collections import Counter
from collections.abc import Callable
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from types import CodeType, FrameType, ModuleType
from typing import Any, NamedTuple

import numba
import numpy as np
from scipy.linalg import blas

FACTORISATIONS = {  # multiply-adds over N^3, or over rows N^2: the least of usual methods
    "cholesky": 1 / 6,
    "eigh": 2 / 3,
    "eigvals": 5 / 3,
    "eigvalsh": 2 / 3,
    "inv": 1.0,
    "lstsq": 2 / 3,
    "pinv": 2 / 3,
    "qr": 2 / 3,
    "svd": 2 / 3,
}
ELEMENT = 8  # bytes
LEAST = 0.01  # of a count: a smaller difference is no growth
PRODUCT = "_counted_product"  # the name of `_product` in counted modules

_compiled: set[CodeType] = set()
multiply_adds: Counter[int] = Counter()  # of matrices, by the bytes of a number


class CallWork(NamedTuple):
    """What a call did, see above, or exponents of it."""

    python: float
    operations: float
    memory: float


def counted(call: Callable[[], object]) -> CallWork:
    """Count a call; it is called once before, so that what is built once is not counted."""
    call()
    python = inside = elements = depth = last = peak = 0
    traced, reset = tracemalloc.get_traced_memory, tracemalloc.reset_peak

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal python, inside, elements, depth, last, peak
        if event == "opcode":
            if depth:
                inside += 1
                return trace
            python += 1
        elif event == "call":
            frame.f_trace_opcodes, frame.f_trace_lines = True, False
            depth += frame.f_code in _compiled
        elif event == "return":
            depth -= frame.f_code in _compiled
        highest = traced()[1]
        peak, elements = max(peak, highest), elements + highest - last
        reset()
        last = traced()[0]
        return trace

    before = sys.gettrace()
    tracemalloc.start()
    multiply_adds.clear()
    first = traced()[0]
    last = peak = first
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
        tracemalloc.stop()
    return CallWork(python, inside + multiply_adds.total() + elements // ELEMENT, peak - first)


def growth(one: float, two: float, four: float) -> float:
    """The exponent p of what grows as c + size^p, from its counts at a size, twice and four times that size.

    p = log2((f(4n) - f(2n)) / (f(2n) - f(n))); log2(f(4n) / f(2n)) where one of the differences is small, or for f(n) = 0.
    """
    first, second, least = two - one, four - two, LEAST * four
    return math.log2(second / first if one and min(first, second) > least else four / two)


def install(package: str = "fusion_sfdia") -> None:
    """Count what the modules of the package do that are imported from now on, in this process, for good.

    RuntimeError where modules with numerical code of it are imported already.
    """
    count_matrices(package, Products())
    numba.njit, np.dot = _left_in_python, counted_dot


def count_matrices(package: str, rewriting: ast.NodeTransformer) -> None:
    """Count multiply-adds of matrices in modules that are imported from now on, those of the package rewritten.

    All but those of np.dot, which compiled functions call. RuntimeError as of `install`.
    """
    rooms = tuple(f"{package}.{room}" for room in ("derivatives", "plant", "filters", "detectors", "models"))
    if known := [name for name in sys.modules if name.startswith(rooms)]:
        raise RuntimeError(f"{known[0]} is imported already; call install before anything of {package}")
    setattr(builtins, PRODUCT, _product)
    for name, share in FACTORISATIONS.items():
        setattr(np.linalg, name, _counting(getattr(np.linalg, name), partial(_cubic, share)))
    np.linalg.solve = _counting(np.linalg.solve, _of_solve)
    np.matmul = _counting(np.matmul, _of_product)
    np.einsum = _counting(np.einsum, _of_sum)
    blas.dtrsm = _counting(blas.dtrsm, lambda alpha, a, b, **_: len(a) * np.size(b) // 2)
    sys.meta_path.insert(0, _Finder(package, rewriting))


def _left_in_python(**_: object) -> Callable[[Any], Any]:
    def mark(function: Any) -> Any:
        _compiled.add(function.__code__)
        return function

    return mark


def _counting(function: Any, amount: Callable[..., int]) -> Any:
    def call(*arguments: Any, **options: Any) -> Any:
        kind = np.result_type(np.float32, *(a for a in arguments if isinstance(a, np.ndarray)))
        multiply_adds[kind.itemsize] += amount(*arguments, **options)
        return function(*arguments, **options)

    return call


def _product(a: Any, b: Any) -> Any:
    """A @ b, counted where both are arrays."""
    return _matmul(a, b) if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) else a @ b


def _of_product(a: Any, b: Any, *_: object, **__: object) -> int:
    """A (..., n, k) times b (..., k, m): n m k for each of the batch."""
    a, b = np.asarray(a), np.asarray(b)
    if not (a.ndim and b.ndim):
        return int(a.size * b.size)
    rows, columns = (a.shape[-2] if a.ndim > 1 else 1), (b.shape[-1] if b.ndim > 1 else 1)
    return math.prod((*np.broadcast_shapes(a.shape[:-2], b.shape[:-2]), rows, columns, a.shape[-1]))


def _cubic(share: float, a: Any, *_: object, **__: object) -> int:
    """That share of N^3 for each matrix of a batch."""
    return int(share * np.size(a) * np.shape(a)[-1])


def _of_solve(a: Any, b: Any) -> int:
    """Triangular factors of each matrix, and both solved for each column of b."""
    return _cubic(1 / 3, a) + int(np.size(b) * np.shape(a)[-1])


def _of_sum(subscripts: str, *operands: Any, **_: object) -> int:
    """The product of the lengths of all its indices, as of one loop over all."""
    lengths: dict[str, int] = {}
    for letters, operand in zip(subscripts.partition("->")[0].split(","), operands, strict=True):
        shape = np.shape(operand)
        own = letters.strip().replace("...", "")
        lengths |= dict(zip(own, shape[len(shape) - len(own) :], strict=True))
        lengths["..."] = max(lengths.get("...", 1), math.prod(shape[: len(shape) - len(own)]))
    return math.prod(lengths.values())


_matmul = _counting(operator.matmul, _of_product)
counted_dot = _counting(np.dot, _of_product)


class Products(ast.NodeTransformer):
    """A module in which products of matrices are counted."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.MatMult):
            return node
        return ast.Call(ast.Name(PRODUCT, ast.Load()), [node.left, node.right], [])


class _Loader(SourceFileLoader):
    def __init__(self, name: str, path: str, rewriting: ast.NodeTransformer) -> None:
        super().__init__(name, path)
        self.rewriting = rewriting

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        tree = self.rewriting.visit(ast.parse(self.get_data(path)))
        code: CodeType = compile(ast.fix_missing_locations(tree), path, "exec", dont_inherit=True)
        return code


class _Finder(MetaPathFinder):
    """Finds what the other finders find; the modules of the package get `_Loader`."""

    def __init__(self, package: str, rewriting: ast.NodeTransformer) -> None:
        self.package, self.rewriting = package, rewriting

    def find_spec(self, name: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if not name.startswith(f"{self.package}."):
            return None
        for finder in sys.meta_path:
            if finder is not self and (spec := finder.find_spec(name, path, target)) is not None:
                if isinstance(spec.loader, SourceFileLoader) and spec.origin:
                    spec.loader = _Loader(name, spec.origin, self.rewriting)
                return spec
        return None
