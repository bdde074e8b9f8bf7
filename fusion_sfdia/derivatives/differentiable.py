"""Steps and outputs that have their Jacobians themselves, and those that give both by one call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Differentiable:
    """A step or output that is called as any other, for models whose Jacobian computes its value, too.

    value, with_jacobian: functions of the same arguments that return the value, or it and its Jacobian.
    """

    value: Callable[..., Array]
    with_jacobian: Callable[..., tuple[Array, Array]]

    def __call__(self, *arguments: Any) -> Array:
        return self.value(*arguments)

    def jacobian(self, *arguments: Any) -> Array:
        """The Jacobian alone."""
        return self.with_jacobian(*arguments)[1]


def with_jacobian(function: Any, jacobian: Any) -> Callable[..., tuple[Array, Array]] | None:
    """What gives value and Jacobian of a step or output by one call; None without it, or where another Jacobian is stated."""
    own = getattr(function, "jacobian", None)
    return getattr(function, "with_jacobian", None) if own is not None and own == jacobian else None
