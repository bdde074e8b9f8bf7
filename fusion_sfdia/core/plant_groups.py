"""The optional groups of a plant: its numerics, the truth of simulations, and its structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.areas import Areas
from fusion_sfdia.core.arguments import number, shown
from fusion_sfdia.core.modules import Modules

if TYPE_CHECKING:
    from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]
StepFunction = Callable[[float, Array, Array, float], Array]
OutputFunction = Callable[[float, Array, Array], Array]
Feedback = Callable[[float, Array, Array], Array]
Finer = Callable[[], "tuple[Plant, Callable[[Array], Array]]"]


@dataclass(frozen=True)
class Numerics:
    """The Jacobians of a model, and the steps for which it holds.

    step_jacobian(t_start, x, u, dt), (..., n, n), and output_jacobian(t, x, u), (..., N, n): None for those that the
    functions have themselves as an attribute `jacobian`, of the same arguments (with an attribute `with_jacobian`, which
    returns both, estimators call the model once, see `differentiable`); otherwise the complex step, or central
    differences (to about 1e-10) where the complex step fails because of abs, sign, interp or the like. Both are compared once,
    at points about x0. At a kink itself, |x| at 0, differences give the mean of both slopes.
    max_dt: longest step (s), inf for no limit. fixed_dt: whether the model holds for the plant's nominal dt only.
    Raises ValueError for a Jacobian that is no function and a max_dt that is not positive.
    """

    step_jacobian: StepFunction | None = None
    output_jacobian: OutputFunction | None = None
    max_dt: float = np.inf
    fixed_dt: bool = False

    def __post_init__(self) -> None:
        _require_functions(self, "step_jacobian", "output_jacobian")
        if not number("max_dt", self.max_dt) > 0:
            raise ValueError(f"max_dt is {self.max_dt} s; it must be positive, inf for no limit")


@dataclass(frozen=True)
class Truth:
    """The truth of simulations, which represents the real plant; a detector uses only its operation, for unknown inputs.

    operation(t): the input (m,) that acts from t on where none is given; None for the nominal values of the inputs.
    feedback(t, y, u): the input (..., m) that acts from t on in closed loop, by controllers that read y (..., N) at t and
    replace u (..., m); None in open loop.
    finer(): a high-fidelity model with the same sensors and inputs (a finer grid, for example) and the map from its states to
    those of the plant; None where there is none. Simulations take their readings from it unless another truth is given.
    disturbed: whether process noise acts on the real plant, too, and on healthy recordings for fitting. Otherwise the
    process noise only represents what the model neglects.
    Raises ValueError for an operation, feedback or finer that is no function.
    """

    operation: Callable[[float], Array] | None = None
    feedback: Feedback | None = None
    finer: Finer | None = None
    disturbed: bool = False

    def __post_init__(self) -> None:
        _require_functions(self, "operation", "feedback", "finer")


@dataclass(frozen=True)
class Structure:
    """The single equations of a plant, in SI.

    modules: the scalar equations as monitoring modules; areas: the linear areas, each with its own diagnoser. None where not
    stated; detectors that need them are then not applicable, and one diagnoser reads all sensors.
    """

    modules: Modules | None = None
    areas: Areas | None = None

    def __post_init__(self) -> None:
        for what, kind in (("modules", Modules), ("areas", Areas)):
            value = getattr(self, what)
            if not isinstance(value, kind | None):
                raise ValueError(f"{what} is {shown(value)}; expected {kind.__name__} or None")


def _require_functions(group: Any, *names: str) -> None:
    for what in names:
        value = getattr(group, what)
        if not (value is None or callable(value)):
            raise ValueError(f"{what} is {shown(value)}; expected a function or None")


def with_same_states(model: Callable[[], Plant]) -> tuple[Plant, Callable[[Array], Array]]:
    """A `Truth.finer` for a model whose states are those of the plant: partial(with_same_states, model)."""
    return model(), np.asarray


# functions of a plant are methods or partials of module functions, not closures, so that plants can be pickled


def scaled(output: Callable[..., Array], factor: Array, *arguments: Any) -> Array:
    """Readings, or their Jacobian, times a factor for each sensor."""
    return output(*arguments) * factor


def fed_back(feedback: Feedback, factor: Array, t: float, y: Array, u: Array) -> Array:
    """The feedback of readings that are given times a factor for each sensor."""
    return feedback(t, y / factor, u)
