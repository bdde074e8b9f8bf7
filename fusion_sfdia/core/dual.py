"""Dual numbers in compiled code: a value and its slope, the derivative along one direction, by the rules of differentiation.

An equation takes them in place of numbers, as it takes complex ones; but they have no branches, and a product takes fewer
operations, so that loops over them become vector instructions:

    (a, a') (b, b') = (a b, a' b + a b'),    (a, a') / (b, b') = (q, (a' - q b') / b)  with q = a / b

The values have the bits that the equation has with numbers.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, make_attribute_wrapper, models, overload, register_model

Rule = Callable[..., Any]

INLINED = {"forceinline": True}


class Dual(types.Type):  # type: ignore[misc]  # numba has no types
    """The type of dual numbers."""

    def __init__(self) -> None:
        super().__init__(name="Dual")


DUAL = Dual()


@register_model(Dual)
class _Pair(models.StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, [("value", types.float64), ("slope", types.float64)])


make_attribute_wrapper(Dual, "value", "value")
make_attribute_wrapper(Dual, "slope", "slope")


@intrinsic  # type: ignore[untyped-decorator]
def dual(context: Any, value: Any, slope: Any) -> Any:
    """The dual number of a value and a slope."""

    def made(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        pair = cgutils.create_struct_proxy(DUAL)(context, builder)
        pair.value, pair.slope = given
        return pair._getvalue()

    return DUAL(types.float64, types.float64), made


def _of_two(operation: Rule, both: Rule, first: Rule, second: Rule) -> None:
    """Define an operation of two dual numbers, of a dual number and a number, and of a number and a dual number."""
    rules = {(True, True): both, (True, False): first, (False, True): second}
    overload(operation, jit_options=INLINED)(lambda a, b: rules.get((isinstance(a, Dual), isinstance(b, Dual))))


def _of_one(operation: Rule, rule: Rule) -> None:
    """Define a function of a dual number."""
    overload(operation, jit_options=INLINED)(lambda a: rule if isinstance(a, Dual) else None)


_of_two(
    operator.add,
    lambda a, b: dual(a.value + b.value, a.slope + b.slope),
    lambda a, b: dual(a.value + b, a.slope),
    lambda a, b: dual(a + b.value, b.slope),
)
_of_two(
    operator.sub,
    lambda a, b: dual(a.value - b.value, a.slope - b.slope),
    lambda a, b: dual(a.value - b, a.slope),
    lambda a, b: dual(a - b.value, -b.slope),
)
_of_two(
    operator.mul,
    lambda a, b: dual(a.value * b.value, a.slope * b.value + a.value * b.slope),
    lambda a, b: dual(a.value * b, a.slope * b),
    lambda a, b: dual(a * b.value, a * b.slope),
)
_of_two(
    operator.truediv,
    lambda a, b: dual(a.value / b.value, (a.slope - a.value / b.value * b.slope) / b.value),
    lambda a, b: dual(a.value / b, a.slope / b),
    lambda a, b: dual(a / b.value, -(a / b.value) * b.slope / b.value),
)
_of_one(operator.neg, lambda a: dual(-a.value, -a.slope))
_of_one(np.log, lambda a: dual(np.log(a.value), a.slope / a.value))
_of_one(np.sqrt, lambda a: dual(np.sqrt(a.value), 0.5 * a.slope / np.sqrt(a.value)))
