"""What a plant does not know about itself: parameters, errors of inputs, disturbances.

A parameter theta enters the model by functions that take its value, `step(t_start, x, u, dt, theta)` and
`output(t, x, u, theta)`: the plant's own equations, or the secants of plants that are built at other values, see `secants`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, require_unique, shown

Array = NDArray[Any]
ParametricStep = Callable[[float, Array, Array, float, Array], Array]
ParametricOutput = Callable[[float, Array, Array, Array], Array]
TREATMENTS = ("estimated", "considered", "frozen")
HOUR = 3600.0  # s


@dataclass(frozen=True)
class Parameter:
    """A number of the model that is not known exactly.

    Parameters
    ----------
    name : str
        Of the parameter.
    unit : str, default "1"
        In which all its numbers are.
    nominal : float, default 0
        Its value in the model.
    sd : float, default 1
        Standard deviation of its true value about the nominal one.
    rate : float, default 0
        Standard deviation of its change within an hour (a random walk); 0 for a constant. It is also the rate of its ageing
        since `tune` has commissioned the plant: the deviation of its change within a hours is rate sqrt(a).
    treatment : str, default "estimated"
        "estimated"; "considered", not estimated, but its uncertainty counts (Schmidt 1966); "frozen", taken as nominal until a
        hypothesis about it is accepted.
    source : str, default ""
        Where the spread comes from.
    low : float, default -inf
        Value below which the model does not hold.
    high : float, default inf
        Value above which the model does not hold.
    meaning : str, default ""
        As of `Sensor`.
    check : str, default ""
        As of `Sensor`.

    Raises
    ------
    ValueError
        For values that are not finite, a spread that is not positive, a negative rate, an unknown treatment and limits that do
        not contain the nominal value.

    Examples
    --------
    >>> from fusion_sfdia import Parameter
    >>> Parameter("outlet", nominal=1.0, sd=0.05, source="tables of discharge coefficients").treatment
    'estimated'
    """

    name: str
    unit: str = "1"
    nominal: float = 0.0
    sd: float = 1.0
    rate: float = 0.0
    treatment: str = "estimated"
    source: str = ""
    low: float = -np.inf
    high: float = np.inf
    meaning: str = ""
    check: str = ""

    def __post_init__(self) -> None:
        for what in ("nominal", "sd", "rate"):
            value = number(f"parameter {self.name!r}: {what}", getattr(self, what))
            least = {"nominal": -np.inf, "sd": np.finfo(float).tiny, "rate": 0.0}[what]
            if not least <= value < np.inf or not np.isfinite(value):
                expected = {"nominal": "finite", "sd": "positive and finite", "rate": "finite and at least 0"}[what]
                raise ValueError(f"parameter {self.name!r}: {what} is {value}; it must be {expected}")
        if not number("low", self.low) <= self.nominal <= number("high", self.high):
            raise ValueError(
                f"parameter {self.name!r}: nominal is {self.nominal}; expected a value from low {self.low} to high {self.high}"
            )
        _require_treatment(f"parameter {self.name!r}", self.treatment)


class PriorSpread(NamedTuple):
    """How far numbers of one kind may differ from the model, apart from their values.

    sd, rate: as of `Parameter`, over its nominal value; of a temperature in K in kelvin.
    """

    unit: str
    sd: float
    rate: float
    source: str

    def parameter(self, name: str, nominal: float, low: float = -np.inf) -> Parameter:
        """The parameter with that nominal value."""
        scale = 1.0 if self.unit == "K" else nominal
        return Parameter(name, self.unit, nominal, self.sd * scale, self.rate * scale, source=self.source, low=low)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """An unknown signal xi that acts on states and readings along fixed directions: x+ += V xi dt / dt_nominal, y += W xi.

    Parameters
    ----------
    name : str
        Of the signal.
    state : array (n,)
        V, in the states' units.
    reading : array (N,)
        W, in the sensors' units.
    sd : float, default 1
        Standard deviation of xi.
    time_constant : float, default inf
        Of its correlation exp(-|t| / time_constant), s; inf for a constant.
    treatment : str, default "estimated"
        As of `Parameter`.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from fusion_sfdia import Uncertainty
    >>> from fusion_sfdia.plants import Disturbance, augment, two_tanks
    >>> leak = Disturbance("leak", state=np.array([-0.01, 0.0]), reading=np.zeros(4), sd=0.2, time_constant=3600.0)
    >>> [state.name for state in augment(replace(two_tanks(), uncertainty=Uncertainty(disturbances=(leak,)))).states]
    ['level_1', 'level_2', 'leak']
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
        _require_treatment(f"disturbance {self.name!r}", self.treatment)


def error_of(name: str) -> str:
    """The name of the error of an input, a state of the augmented plant."""
    return f"error of {name}"


def equation_of(name: str) -> str:
    """The name of the hypothesis that the equation of a state errs."""
    return f"equation of {name}"


def _require_treatment(whose: str, treatment: str) -> None:
    if treatment not in TREATMENTS:
        raise ValueError(f"{whose}: treatment is {shown(treatment)}; expected one of {', '.join(TREATMENTS)}")


@dataclass(frozen=True)
class Uncertainty:
    """What the model does not know.

    Parameters
    ----------
    parameters : tuple of Parameter (p,), default ()
        Numbers of the model that are not known exactly.
    step : callable, optional
        step(t_start, x, u, dt, theta (..., p)): that of the plant at other values of the parameters, in their units; needed
        with parameters, see `secants`. At the nominal values it is the plant's.
    output : callable, optional
        output(t, x, u, theta), likewise; None where the parameters do not act on the readings.
    step_jacobian : callable, optional
        step_jacobian(t_start, x, u, dt, theta) -> (..., n, n + m + p): the derivatives with respect to x, u and theta, side by
        side; None for the complex step, or differences where that fails.
    output_jacobian : callable, optional
        output_jacobian(t, x, u, theta) -> (..., N, n + m + p), likewise.
    inputs : mapping of str to float, default {}
        Standard deviation of the constant error of an input, by its name, in its unit.
    disturbances : tuple of Disturbance, default ()
        Unknown signals.
    considered : tuple of str, default ()
        Names of states that a filter does not update, but whose uncertainty counts; `augment` adds those of this treatment.
    changes : mapping of str to float, default {}
        Standard deviation from which the size of a later change is judged, by the name of a parameter or `error_of` an input,
        where it differs from that of the present value: a healthy log shows a value, not how far it may change.
    at_rest : bool, default False
        Whether x0 is a steady state under the usual input, which follows from the parameters and the inputs that act.
    fits : bool, default False
        Whether healthy readings of these sensors have shown that they fit the model. A constant error of a sensor is then its
        fault, also since the first sample; without that the model may be wrong as well.
    rebuild : callable, optional
        The plant at other values, rebuild(**{parameter: value}), of any number of parameters; None where only step and output
        state them.

    Raises
    ------
    ValueError
        For what does not fit together.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from fusion_sfdia import Uncertainty
    >>> from fusion_sfdia.plants import augment, two_tanks
    >>> plant = two_tanks()
    >>> leaking = replace(plant, uncertainty=Uncertainty(inputs={plant.inputs[0].name: 1e-5}))
    >>> [state.name for state in augment(leaking).states]
    ['level_1', 'level_2', 'error of inflow']
    """

    parameters: tuple[Parameter, ...] = ()
    step: ParametricStep | None = None
    output: ParametricOutput | None = None
    step_jacobian: ParametricStep | None = None
    output_jacobian: ParametricOutput | None = None
    inputs: Mapping[str, float] = field(default_factory=dict)
    disturbances: tuple[Disturbance, ...] = ()
    considered: tuple[str, ...] = ()
    changes: Mapping[str, float] = field(default_factory=dict)
    at_rest: bool = False
    fits: bool = False
    rebuild: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        for what, kind in (("parameters", Parameter), ("disturbances", Disturbance), ("considered", str)):
            object.__setattr__(self, what, tuple(getattr(self, what)))
            if wrong := [v for v in getattr(self, what) if not isinstance(v, kind)]:
                raise ValueError(f"{what} have {shown(wrong[0])}; expected objects of {kind.__name__}")
        require_unique(
            "parameters and disturbances", [*(p.name for p in self.parameters), *(d.name for d in self.disturbances)]
        )
        for what in ("step", "output", "step_jacobian", "output_jacobian", "rebuild"):
            value = getattr(self, what)
            if not (value is None or callable(value)):
                raise ValueError(f"{what} at other values of the parameters is {shown(value)}; expected a function or None")
        if self.parameters and self.step is None:
            raise ValueError(
                "parameters are given without the model at other values; give step and output, or use "
                "fusion_sfdia.plants.secants(plant, parameters, rebuild)"
            )
        for name, sd in self.inputs.items():
            if not 0 < number(f"error of input {name!r}", sd) < np.inf:
                raise ValueError(f"error of input {name!r} is {sd}; its standard deviation must be positive and finite")
        for name, sd in self.changes.items():
            if not 0 < number(f"change of {name!r}", sd) < np.inf:
                raise ValueError(f"change of {name!r} is {sd}; its standard deviation must be positive and finite")

    @property
    def stated(self) -> bool:
        """Whether anything is stated that `augment` adds as a state."""
        return bool(self.parameters or self.inputs or self.disturbances)

    @property
    def nominal(self) -> Array:
        """Nominal values of the parameters (p,)."""
        return np.array([p.nominal for p in self.parameters])

    @property
    def sd(self) -> Array:
        """Standard deviations of the parameters (p,)."""
        return np.array([p.sd for p in self.parameters])


def by_states_alone(readout: Array, u: Array, theta: Array) -> Array:
    """Return the `output_jacobian` (N, n + m + p) of readings that depend on the states alone, by H (N, n)."""
    n = readout.shape[1]
    found = np.zeros((readout.shape[0], n + u.shape[-1] + theta.shape[-1]))
    found[:, :n] = readout
    return found
