"""Set inversion by codac (C++; the optional extra `codac`), with the arguments and the result of `sivia`.

An independent implementation, for comparison or as an alternative. It has no budget and takes one problem at a time. codac sets
the processor to round upward when it is imported, and its x87 unit, with which BLAS takes norms, to double precision;
`rounding_to_nearest` restores both after each use.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion_sfdia.derivatives.intervals.expression import Expression, record
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.sivia import Boxes, Paving, checked_size

Array = NDArray[Any]


@contextmanager
def rounding_to_nearest() -> Iterator[None]:
    """Restore the floating-point environment of before, and rounding to nearest, at the end of the block.

    By C's fegetenv, fesetenv and fesetround, whose FE_TONEAREST is 0 on x86 and ARM.
    """
    c = ctypes.CDLL(ctypes.util.find_library("m") or ctypes.util.find_msvcrt())  # type: ignore[attr-defined]
    before = ctypes.create_string_buffer(256)  # more than any fenv_t has, 32 on x86-64
    c.fegetenv(before)
    try:
        yield
    finally:
        c.fesetenv(before)
        c.fesetround(0)


@rounding_to_nearest()
def codac_sivia(
    function: Callable[..., Any] | Expression,
    target: Interval | Sequence[Interval],
    box: Interval,
    tolerance: float,
    *,
    parameters: Sequence[Interval | ArrayLike] = (),
) -> Paving:
    """Return the pavings of `sivia` as codac finds them; box: (n,), targets and parameters: ().

    `examined` is the number of returned boxes. Raises ImportError without codac, and ValueError for bad input as
    `sivia` does, for a batch, and for a function that codac does not have.
    """
    try:
        import codac
    except ImportError as error:
        raise ImportError("codac is not installed: pip install 'fusion-sfdia[codac]', or use our own sivia") from error
    n = checked_size(box, tolerance, budget=1)
    expression = record(function, n + len(parameters))
    targets = [target] if isinstance(target, Interval) else list(target)
    given = [p if isinstance(p, Interval) else Interval(p) for p in parameters]
    if box.shape != (n,) or any(x.shape for x in (*targets, *given)):
        raise ValueError("codac takes one problem at a time: expected box (n,), targets and parameters without a batch")

    def interval(x: Interval) -> Any:
        return codac.Interval(float(x.lo), float(x.hi))

    operations: dict[np.ufunc, Callable[..., Any]] = {
        np.positive: lambda x: x,
        np.negative: lambda x: -x,
        np.add: lambda x, y: x + y,
        np.subtract: lambda x, y: x - y,
        np.multiply: lambda x, y: x * y,
        np.divide: lambda x, y: x / y,
        np.reciprocal: lambda x: codac.Interval(1) / x,
        np.power: lambda x, y: codac.pow(x, int(y.lb()) if y.is_degenerated() and y.lb().is_integer() else y),
        np.square: codac.sqr,
        np.absolute: codac.abs,
        np.minimum: codac.min,
        np.maximum: codac.max,
        np.sqrt: codac.sqrt,
        np.exp: codac.exp,
        np.log: codac.log,
        np.tanh: codac.tanh,
        np.sin: codac.sin,
        np.cos: codac.cos,
    }
    x = codac.VectorVar(n)
    values: list[Any] = [*(x[i] for i in range(n)), *(interval(p) for p in given)]
    values += [interval(slot) if isinstance(slot, Interval) else None for slot in expression.slots[len(values) :]]
    for i, ufunc, operands in expression.operations:
        if ufunc not in operations:
            raise ValueError(f"codac has no {ufunc.__name__}: use our own sivia")
        values[i] = operations[ufunc](*(values[k] for k in operands))
    results, expected = [values[i] for i in expression.outputs], [interval(t) for t in targets]
    start = codac.IntervalVector([[float(lo), float(hi)] for lo, hi in zip(box.lo, box.hi, strict=True)])
    if len(results) == 1:
        found = codac.sivia(start, codac.AnalyticFunction([x], results[0]), expected[0], tolerance)
    else:
        analytic = codac.AnalyticFunction([x], codac.vec(*results))
        found = codac.sivia(start, analytic, codac.IntervalVector(expected), tolerance)

    def boxes(kind: Any) -> Boxes:
        ends = [[(b[i].lb(), b[i].ub()) for b in found.boxes(kind) if not b.is_empty()] for i in range(n)]
        lo, hi = np.moveaxis(np.array(ends, dtype=float).reshape(n, -1, 2), -1, 0)
        return Boxes(Interval(lo, hi), np.zeros(lo.shape[1], dtype=int))

    inner, boundary = boxes(codac.PavingInOut.inner), boxes(codac.PavingInOut.bound)
    return Paving.of(inner, boundary, np.array(True), np.array(len(inner) + len(boundary)))
