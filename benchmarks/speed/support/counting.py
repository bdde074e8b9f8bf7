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
import sys
import tracemalloc
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from types import CodeType, FrameType, ModuleType
from typing import Any, NamedTuple

import numba
import numpy as np

FACTORISATIONS = ("cholesky", "eigh", "eigvals", "eigvalsh", "inv", "lstsq", "pinv", "qr", "solve", "svd")
ELEMENT = 8  # bytes
LEAST = 0.01  # of a count: a smaller difference is no growth
PRODUCT = "_counted_product"  # the name of `_product` in counted modules

_compiled: set[CodeType] = set()
_multiply_adds = 0


class Work(NamedTuple):
    """What a call did, see above, or exponents of it."""

    python: float
    operations: float
    memory: float


def counted(call: Callable[[], object]) -> Work:
    """Count a call; it is called once before, so that what is built once is not counted."""
    global _multiply_adds
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
    _multiply_adds, first = 0, traced()[0]
    last = peak = first
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
        tracemalloc.stop()
    return Work(python, inside + _multiply_adds + elements // ELEMENT, peak - first)


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
    if known := [name for name in sys.modules if name.startswith((f"{package}.core", f"{package}.models"))]:
        raise RuntimeError(f"{known[0]} is imported already; call install before anything of {package}")
    setattr(builtins, PRODUCT, _product)
    numba.njit = _left_in_python
    for name in FACTORISATIONS:
        setattr(np.linalg, name, _counting(getattr(np.linalg, name), _cubic))
    np.matmul = _counting(np.matmul, lambda a, b, **_: _of_product(np.asarray(a), np.asarray(b)))
    np.einsum = _counting(np.einsum, _of_sum)
    sys.meta_path.insert(0, _Finder(package))


def _left_in_python(**_: object) -> Callable[[Any], Any]:
    def mark(function: Any) -> Any:
        _compiled.add(function.__code__)
        return function

    return mark


def _counting(function: Any, amount: Callable[..., int]) -> Any:
    def call(*arguments: Any, **options: Any) -> Any:
        global _multiply_adds
        _multiply_adds += amount(*arguments, **options)
        return function(*arguments, **options)

    return call


def _product(a: Any, b: Any) -> Any:
    """A @ b (..., n, m) over k: n m k multiply-adds for each of the batch."""
    global _multiply_adds
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        _multiply_adds += _of_product(a, b)
    return a @ b


def _of_product(a: np.ndarray[Any, Any], b: np.ndarray[Any, Any]) -> int:
    rows, columns = (a.shape[-2] if a.ndim > 1 else 1), (b.shape[-1] if b.ndim > 1 else 1)
    return math.prod((*np.broadcast_shapes(a.shape[:-2], b.shape[:-2]), rows, columns, a.shape[-1]))


def _cubic(a: Any, *_: object, **__: object) -> int:
    """N^3 for each matrix of a batch; the factor depends on the method."""
    return int(np.size(a) * np.shape(a)[-1])


def _of_sum(subscripts: str, *operands: Any, **_: object) -> int:
    """The product of the lengths of all its indices, as of one loop over all."""
    lengths: dict[str, int] = {}
    for letters, operand in zip(subscripts.partition("->")[0].split(","), operands, strict=True):
        shape = np.shape(operand)
        own = letters.strip().replace("...", "")
        lengths |= dict(zip(own, shape[len(shape) - len(own) :], strict=True))
        lengths["..."] = max(lengths.get("...", 1), math.prod(shape[: len(shape) - len(own)]))
    return math.prod(lengths.values())


class _Products(ast.NodeTransformer):
    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.MatMult):
            return node
        return ast.Call(ast.Name(PRODUCT, ast.Load()), [node.left, node.right], [])


class _Loader(SourceFileLoader):
    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        tree = _Products().visit(ast.parse(self.get_data(path)))
        code: CodeType = compile(ast.fix_missing_locations(tree), path, "exec", dont_inherit=True)
        return code


class _Finder(MetaPathFinder):
    """Finds what the other finders find; the modules of the package get `_Loader`."""

    def __init__(self, package: str) -> None:
        self.package = package

    def find_spec(self, name: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if not name.startswith(f"{self.package}."):
            return None
        for finder in sys.meta_path:
            if finder is not self and (spec := finder.find_spec(name, path, target)) is not None:
                if isinstance(spec.loader, SourceFileLoader) and spec.origin:
                    spec.loader = _Loader(name, spec.origin)
                return spec
        return None
