"""Continuous-time physics, an ODE or a DAE of index 1, and its blocks; `discretise` turns it into a plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from fusion_sfdia.core.arguments import require_unique
from fusion_sfdia.core.signals import Signal

Array = NDArray[Any]


@dataclass(frozen=True)
class Block:
    """A named part of the physics: the variables it computes and the blocks from which it needs variables."""

    name: str
    variables: tuple[str, ...]
    neighbours: tuple[str, ...] = ()


@dataclass(frozen=True)
class Physics:
    """Continuous-time physics: dx/dt = f(t, x, z, u, c) and, for a DAE of index 1, z = phi(t, x, z, u, c).

    states, inputs, algebraic: the signals of x (..., n), u (..., m) and z (..., k).
    f, phi: functions of batches, analytic in x, z and u so that Jacobians come from the complex step.
    parameters: c, usually a NamedTuple of floats.
    equations: the scalar equations behind f and phi by the variable they give; their argument names are the structure.
    blocks: the parts of the physics and their neighbours.
    """

    name: str
    states: tuple[Signal, ...]
    f: Callable[[float, Array, Array, Array, Any], Array]
    inputs: tuple[Signal, ...] = ()
    algebraic: tuple[Signal, ...] = ()
    phi: Callable[[float, Array, Array, Array, Any], Array] | None = None
    parameters: Any = None
    equations: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    blocks: tuple[Block, ...] = ()

    def __post_init__(self) -> None:
        names = [s.name for s in (*self.states, *self.inputs, *self.algebraic)]
        require_unique(f"physics {self.name!r}", names)
        if bool(self.algebraic) != (self.phi is not None):
            raise ValueError(f"physics {self.name!r}: algebraic variables and phi go together; give both or neither")
        block_names = {b.name for b in self.blocks}
        for block in self.blocks:
            unknown = [v for v in block.variables if v not in names] + [b for b in block.neighbours if b not in block_names]
            if unknown:
                raise ValueError(f"block {block.name!r} names unknown variables or neighbours: {', '.join(unknown)}")
        unknown = [v for v in self.equations if v not in names]
        if unknown:
            raise ValueError(f"physics {self.name!r}: equations for unknown variables {', '.join(unknown)}")
