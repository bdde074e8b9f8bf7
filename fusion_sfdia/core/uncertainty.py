"""What a plant does not know about itself: parameters, errors of inputs, disturbances.

A parameter theta enters the model by functions that take its value, `step(t_start, x, u, dt, theta)` and
`output(t, x, u, theta)`: the plant's own equations, or the secants of plants that are built at other values, see `secants`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import number, require_unique, shown

if TYPE_CHECKING:
    from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]
ParametricStep = Callable[[float, Array, Array, float, Array], Array]
ParametricOutput = Callable[[float, Array, Array, Array], Array]
TREATMENTS = ("estimated", "considered", "frozen")
HOUR = 3600.0  # s


@dataclass(frozen=True)
class Parameter:
    """A number of the model that is not known exactly.

    nominal: its value in the model. sd: standard deviation of its true value about it. rate: standard deviation of its change
    within an hour (a random walk); 0 for a constant. All in its unit. treatment: "estimated"; "considered", not estimated, but
    its uncertainty counts (Schmidt 1966); "frozen", taken as nominal until a hypothesis about it is accepted.
    source: where the spread comes from. Raises ValueError for values that are not finite, a spread that is not positive, a
    negative rate and an unknown treatment.
    """

    name: str
    unit: str = "1"
    nominal: float = 0.0
    sd: float = 1.0
    rate: float = 0.0
    treatment: str = "estimated"
    source: str = ""

    def __post_init__(self) -> None:
        for what in ("nominal", "sd", "rate"):
            value = number(f"parameter {self.name!r}: {what}", getattr(self, what))
            least = {"nominal": -np.inf, "sd": np.finfo(float).tiny, "rate": 0.0}[what]
            if not least <= value < np.inf or not np.isfinite(value):
                expected = {"nominal": "finite", "sd": "positive and finite", "rate": "finite and at least 0"}[what]
                raise ValueError(f"parameter {self.name!r}: {what} is {value}; it must be {expected}")
        if self.treatment not in TREATMENTS:
            raise ValueError(
                f"parameter {self.name!r}: treatment is {shown(self.treatment)}; expected one of {', '.join(TREATMENTS)}"
            )


@dataclass(frozen=True, eq=False)
class Disturbance:
    """An unknown signal xi that acts on states and readings along fixed directions: x+ += V xi dt / dt_nominal, y += W xi.

    state: V (n,) in the states' units. reading: W (N,) in the sensors' units. sd: standard deviation of xi.
    time_constant: of its correlation exp(-|t| / time_constant), s; inf for a constant.
    """

    name: str
    state: Array
    reading: Array
    sd: float = 1.0
    time_constant: float = np.inf
    treatment: str = "estimated"

    def __post_init__(self) -> None:
        for what in ("state", "reading"):
            object.__setattr__(self, what, np.asarray(getattr(self, what), dtype=float))
        if not 0 < number(f"disturbance {self.name!r}: sd", self.sd) < np.inf:
            raise ValueError(f"disturbance {self.name!r}: sd is {self.sd}; it must be positive and finite")
        if not number(f"disturbance {self.name!r}: time_constant", self.time_constant) > 0:
            raise ValueError(f"disturbance {self.name!r}: time_constant is {self.time_constant} s; it must be positive")
        if self.treatment not in TREATMENTS:
            raise ValueError(f"disturbance {self.name!r}: treatment is {shown(self.treatment)}; expected one of {TREATMENTS}")


@dataclass(frozen=True)
class Uncertainty:
    """What the model does not know.

    parameters: p of them. step, output: the model at other values, theta (..., p) in the parameters' units; needed with
    parameters, see `secants`. step_sensitivity(t_start, x, u, dt, theta), (..., n, p), and output_sensitivity(t, x, u, theta),
    (..., N, p): their derivatives with respect to theta; None for the complex step, or differences where that fails.
    inputs: standard deviation of the constant error of an input, by its name, in its unit.
    disturbances: unknown signals. considered: names of states that a filter does not update, but whose uncertainty counts
    (`augment` states them). rebuild: the plant at other values, rebuild(**{parameter: value}), of any number of parameters;
    None where only step and output state them. Raises ValueError for what does not fit together.
    """

    parameters: tuple[Parameter, ...] = ()
    step: ParametricStep | None = None
    output: ParametricOutput | None = None
    step_sensitivity: ParametricStep | None = None
    output_sensitivity: ParametricOutput | None = None
    inputs: Mapping[str, float] = field(default_factory=dict)
    disturbances: tuple[Disturbance, ...] = ()
    considered: tuple[str, ...] = ()
    rebuild: Callable[..., Plant] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        object.__setattr__(self, "disturbances", tuple(self.disturbances))
        require_unique("parameters and disturbances", [p.name for p in (*self.parameters, *self.disturbances)])
        for what, kind in (("parameters", Parameter), ("disturbances", Disturbance)):
            if wrong := [v for v in getattr(self, what) if not isinstance(v, kind)]:
                raise ValueError(f"{what} have {shown(wrong[0])}; expected {kind.__name__}s")
        if self.parameters and not (callable(self.step) and callable(self.output)):
            raise ValueError(
                "parameters are given without the model at other values; give step and output, or use "
                "secants(plant, parameters, rebuild)"
            )
        for name, sd in self.inputs.items():
            if not 0 < number(f"error of input {name!r}", sd) < np.inf:
                raise ValueError(f"error of input {name!r} is {sd}; its standard deviation must be positive and finite")

    @property
    def stated(self) -> bool:
        """Whether anything is stated."""
        return bool(self.parameters or self.inputs or self.disturbances)


@dataclass(frozen=True, eq=False)
class Secants:
    """A model at other values of its parameters, from plants at nominal -+ sd of each.

    With tau_j = (theta_j - nominal_j) / sd_j and f+-_j the model at +-1 of tau_j alone,

        f(theta) = f + sum_j [tau_j (f+_j - f-_j) / 2 + tau_j^2 (f+_j + f-_j - 2 f) / 2]

    exact where the model is quadratic in each parameter and has no products of them.
    """

    plant: Plant
    pairs: tuple[tuple[Plant, Plant], ...]
    nominal: Array
    sd: Array

    def step(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        return self._at(lambda plant: plant.step(t_start, x, u, dt), theta)

    def output(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        return self._at(lambda plant: plant.output(t, x, u), theta)

    def step_sensitivity(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        return self._slope(lambda plant: plant.step(t_start, x, u, dt), theta)

    def output_sensitivity(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        return self._slope(lambda plant: plant.output(t, x, u), theta)

    def _at(self, model: Callable[[Plant], Array], theta: Array) -> Array:
        tau = (theta - self.nominal) / self.sd
        f = model(self.plant)
        total = f
        for j, (below, above) in enumerate(self.pairs):
            minus, plus, by = model(below), model(above), tau[..., j, None]
            total = total + by * (plus - minus) / 2 + by**2 * (plus + minus - 2 * f) / 2
        return np.asarray(total)

    def _slope(self, model: Callable[[Plant], Array], theta: Array) -> Array:
        tau = (theta - self.nominal) / self.sd
        f = model(self.plant)
        columns = []
        for j, (below, above) in enumerate(self.pairs):
            minus, plus = model(below), model(above)
            columns.append(((plus - minus) / 2 + tau[..., j, None] * (plus + minus - 2 * f)) / self.sd[j])
        return np.stack(np.broadcast_arrays(*columns), axis=-1)


def secants(plant: Plant, parameters: tuple[Parameter, ...], rebuild: Callable[..., Plant], **stated: Any) -> Uncertainty:
    """Uncertainty of the parameters of a plant that can be built at other values: rebuild(**{parameter: value}).

    rebuild takes any number of the parameters, the others keep their values. stated: inputs and disturbances, as of
    `Uncertainty`. ValueError where a rebuilt plant has other states, sensors or inputs.
    """
    pairs = []
    for p in parameters:
        below, above = (rebuild(**{p.name: p.nominal + sign * p.sd}) for sign in (-1.0, 1.0))
        for other in (below, above):
            for what in ("states", "sensors", "inputs"):
                if [s.name for s in getattr(other, what)] != [s.name for s in getattr(plant, what)]:
                    raise ValueError(f"parameter {p.name!r}: the plant rebuilt at another value has other {what}")
        pairs.append((below, above))
    at = Secants(plant, tuple(pairs), np.array([p.nominal for p in parameters]), np.array([p.sd for p in parameters]))
    if not parameters:
        return Uncertainty(**stated)
    functions = at.step, at.output, at.step_sensitivity, at.output_sensitivity
    return Uncertainty(tuple(parameters), *functions, rebuild=rebuild, **stated)
