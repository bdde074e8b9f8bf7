"""Right-hand sides as straight-line programs: recorded once by running them on symbols, then interpreted by compiled code.

The equations keep their one source, Python functions on arrays: `record` runs them once, on arrays of symbols, and keeps the
operations in their order. One compiled interpreter, the same for every plant, then evaluates them for each state of a batch,
with forward-mode derivatives where asked (Griewank and Walther 2008, sec. 3.1): no call of NumPy for each operation. A function
that branches on values, or uses what is not in `FUNCTIONS`, cannot be recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

CONSTANT, ADD, SUBTRACT, MULTIPLY, DIVIDE, POWER, NEGATE = range(7)
FUNCTIONS = ("sqrt", "exp", "expm1", "log", "log10", "log1p", "sin", "cos", "tanh", "arctan")  # operations 7, 8 ..
POINTS = 4  # at which a program is compared with its functions
OPERATORS = (None, np.add, np.subtract, np.multiply, np.divide, np.power, np.negative, *(getattr(np, f) for f in FUNCTIONS))


class Program(NamedTuple):
    """Operations on slots: first the inputs [t, x (n), z (k), u (m), theta (p)], then constants and operations in their order.

    operations (S, 3): operation and its one or two operands. value (S,): of constants, 0 otherwise. first: slot of the first
    operation of f, before which those of phi stand. phi (k,), f (n,): slots of the results. implicit: whether phi depends on z.
    """

    operations: Array
    value: Array
    first: int
    phi: Array
    f: Array
    implicit: bool


class _Recorder:
    """Slots of a program in preparation."""

    def __init__(self, inputs: int) -> None:
        self.slots: list[tuple[int, int, int]] = [(CONSTANT, 0, 0)] * inputs
        self.value = [0.0] * inputs
        self.known: dict[Any, int] = {}

    def slot(self, operation: tuple[int, int, int], value: float = 0.0) -> int:
        """The slot of an operation, a new one where it has not been recorded yet."""
        key = (operation, value)
        if operation[0] == CONSTANT and value == 0.0:  # not -0.0
            key = (operation, str(value))  # type: ignore[assignment]
        if key not in self.known:
            self.known[key] = len(self.slots)
            self.slots.append(operation)
            self.value.append(value)
        return self.known[key]

    def slot_of(self, x: Any) -> int:
        """The slot of a symbol or of a real number; TypeError for anything else."""
        if isinstance(x, np.ndarray) and x.ndim == 0:
            x = x[()]
        if isinstance(x, Symbol):
            if x.recorder is not self:
                raise TypeError("a symbol of another recording")
            return x.index
        if isinstance(x, bool | complex | np.complexfloating) or not isinstance(x, float | int | np.floating | np.integer):
            raise TypeError(f"{x!r} is no number")
        return self.slot((CONSTANT, 0, 0), float(x))


class Symbol:
    """A slot during recording: an operation on it records another. It has no value: a branch on it is a TypeError."""

    __slots__ = ("index", "recorder")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, recorder: _Recorder, index: int) -> None:
        self.recorder, self.index = recorder, index

    def _then(self, operation: int, left: Any, right: Any) -> Any:
        if any(isinstance(x, np.ndarray) and x.ndim > 0 for x in (left, right)):
            return NotImplemented  # NumPy takes the elements one by one
        of = self.recorder.slot_of
        return Symbol(self.recorder, self.recorder.slot((operation, of(left), of(right))))

    def __add__(self, other: Any) -> Any:
        return self._then(ADD, self, other)

    def __radd__(self, other: Any) -> Any:
        return self._then(ADD, other, self)

    def __sub__(self, other: Any) -> Any:
        return self._then(SUBTRACT, self, other)

    def __rsub__(self, other: Any) -> Any:
        return self._then(SUBTRACT, other, self)

    def __mul__(self, other: Any) -> Any:
        return self._then(MULTIPLY, self, other)

    def __rmul__(self, other: Any) -> Any:
        return self._then(MULTIPLY, other, self)

    def __truediv__(self, other: Any) -> Any:
        return self._then(DIVIDE, self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._then(DIVIDE, other, self)

    def __pow__(self, other: Any) -> Any:
        if isinstance(other, int | float) and other == 2:  # as NumPy does
            return self * self
        if isinstance(other, int | float) and other == 0.5:
            return self._of(FUNCTIONS.index("sqrt"))
        return self._then(POWER, self, other)

    def __rpow__(self, other: Any) -> Any:
        return self._then(POWER, other, self)

    def __neg__(self) -> Any:
        return Symbol(self.recorder, self.recorder.slot((NEGATE, self.index, 0)))

    def __pos__(self) -> Any:
        return self

    def __bool__(self) -> bool:
        raise TypeError("a branch on a value")

    def __eq__(self, other: object) -> bool:
        raise TypeError("a comparison of values")

    def __ne__(self, other: object) -> bool:
        raise TypeError("a comparison of values")

    def __getattr__(self, name: str) -> Callable[[], Symbol]:
        """The functions that NumPy calls on the elements of an array of objects."""
        if name not in FUNCTIONS:
            raise AttributeError(name)
        return lambda: self._of(FUNCTIONS.index(name))

    def _of(self, function: int) -> Symbol:
        return Symbol(self.recorder, self.recorder.slot((NEGATE + 1 + function, self.index, 0)))


RightHandSide = Callable[[Any, Array, Array, Array, Array], Array]


def record(f: RightHandSide, phi: RightHandSide | None, usual: Sequence[Array]) -> Program | None:
    """Return the program of x' = f(t, x, z, u, theta), z = phi(t, x, z, u, theta), or None where it cannot be recorded.

    usual: values of x (n,), z (k,), u (m,), theta (p,). Both functions are run once on arrays of symbols and once on numbers
    near the usual values, where the program must give what they give: a function with a memory does not.
    """
    ends = np.cumsum([1, *(a.size for a in usual)])
    recorder = _Recorder(int(ends[-1]))
    symbols = np.empty(ends[-1], dtype=object)
    symbols[:] = [Symbol(recorder, i) for i in range(ends[-1])]
    x, z, u, theta = np.split(symbols[1:], ends[:-1] - 1)[1:]
    arguments = (symbols[0], x, z, u, theta)
    try:
        by_phi = _slots(recorder, phi(*arguments), z.size) if phi is not None else []
        first = len(recorder.slots)
        recorder.known.clear()  # phi is evaluated for another z
        by_f = _slots(recorder, f(*arguments), x.size)
    except Exception:  # whatever a function of numbers raises for symbols
        return None
    on_z = np.zeros(len(recorder.slots), bool)
    on_z[ends[1] : ends[2]] = True
    for s in range(ends[-1], first):
        operation, left, right = recorder.slots[s]
        on_z[s] = operation != CONSTANT and (on_z[left] or (operation < NEGATE and on_z[right]))
    slots, value = np.array(recorder.slots, dtype=np.int64), np.array(recorder.value)
    of_phi, of_f = np.array(by_phi, dtype=np.int64), np.array(by_f, dtype=np.int64)
    program = Program(slots, value, first, of_phi, of_f, bool(on_z[of_phi].any()))
    return program if _agrees(program, f, phi, usual) else None


def uses(program: Program, slot: int) -> bool:
    """Whether an operation or a result depends on the value of a slot."""
    operation, left, right = program.operations.T
    by_left, by_right = operation != CONSTANT, (operation != CONSTANT) & (operation < NEGATE)
    used = np.any(by_left & (left == slot)) or np.any(by_right & (right == slot))
    return bool(used or slot in program.phi or slot in program.f)


def _agrees(program: Program, f: RightHandSide, phi: RightHandSide | None, usual: Sequence[Array]) -> bool:
    """Whether the program gives what the functions give, at points within a tenth of the usual values."""
    rng = np.random.default_rng(0)
    inputs = [np.where(a == 0, 0.1, a) * rng.uniform(0.9, 1.1, (POINTS, a.size)) for a in usual]
    with np.errstate(all="ignore"):
        try:
            stated = [f(1.0, *inputs), *([] if phi is None else [phi(1.0, *inputs)])]
        except Exception:  # a model that has no value there
            return False
        by_phi, by_f = evaluated(program, [np.array(1.0), *(column for a in inputs for column in a.T)])
    for expected, found in zip(stated, (by_f, by_phi), strict=False):
        values = np.stack(np.broadcast_arrays(*found, np.zeros(POINTS))[:-1], axis=-1)
        finite = np.abs(values[np.isfinite(values)])
        if not np.allclose(values, expected, rtol=1e-6, atol=1e-9 * finite.max(initial=0.0), equal_nan=True):
            return False
    return True


def _slots(recorder: _Recorder, results: Array, count: int) -> list[int]:
    if np.shape(results) != (count,):
        raise TypeError("a function that does not keep the shape")
    return [recorder.slot_of(r) for r in results]


def evaluated(program: Program, inputs: Sequence[Array]) -> tuple[list[Array], list[Array]]:
    """Evaluate phi and f by NumPy, of the inputs t, x.., z.., u.., theta.. as batches; f with the inputs' z."""
    values: list[Any] = list(inputs)
    for (operation, left, right), value in zip(program.operations[len(inputs) :], program.value[len(inputs) :], strict=True):
        if (ufunc := OPERATORS[operation]) is None:
            values.append(value)
        else:
            values.append(ufunc(*(values[k] for k in (left, right)[: ufunc.nin])))
    return [values[k] for k in program.phi], [values[k] for k in program.f]
