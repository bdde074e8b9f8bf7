"""Continuous-time physics, an ODE or a DAE of index 1; `discretise` makes a plant of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from fusion_sfdia.common.arguments import require_unique
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]


@dataclass(frozen=True)
class Physics:
    """Continuous-time physics: dx/dt = f(t, x, z, u, c) and, for a DAE of index 1, z = phi(t, x, z, u, c).

    Parameters
    ----------
    name : str
        Of the plant.
    states : tuple of Signal
        The signals of x (..., n).
    f : callable
        A function of batches, analytic in x, z and u so that Jacobians come from the complex step; returns (..., n) per s.
    inputs : tuple of Signal, default ()
        The signals of u (..., m).
    algebraic : tuple of Signal, default ()
        The signals of z (..., k).
    phi : callable, optional
        As f; returns (..., k).
    parameters : optional
        c, usually a NamedTuple of floats.

    Raises
    ------
    ValueError
        For names that are not unique and for algebraic variables without phi or phi without them.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import Physics, Signal
    >>> tank = Physics("tank", (Signal("level", "m", 1.0),), f=lambda t, x, z, u, c: u - z,
    ...                inputs=(Signal("inflow", "m/s", 1e-3),), algebraic=(Signal("outflow", "m/s", 1e-3),),
    ...                phi=lambda t, x, z, u, c: c * np.sqrt(x), parameters=1e-3)
    >>> tank.phi(0.0, np.array([4.0]), np.zeros(1), np.zeros(1), tank.parameters)
    array([0.002])
    """

    name: str
    states: tuple[Signal, ...]
    f: Callable[[float, Array, Array, Array, Any], Array]
    inputs: tuple[Signal, ...] = ()
    algebraic: tuple[Signal, ...] = ()
    phi: Callable[[float, Array, Array, Array, Any], Array] | None = None
    parameters: Any = None

    def __post_init__(self) -> None:
        names = [s.name for s in (*self.states, *self.inputs, *self.algebraic)]
        require_unique(f"physics {self.name!r}", names)
        if bool(self.algebraic) != (self.phi is not None):
            raise ValueError(f"physics {self.name!r}: algebraic variables and phi go together; give both or neither")
