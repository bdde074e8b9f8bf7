"""A plant's equations as monitoring modules, one for each measured variable (Kougiatsos 2024, sec. III)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import argument_names

Array = NDArray[Any]


class ObserverBound(NamedTuple):
    """Constants of the threshold (10) of an observer: |e^(A t)| <= rho e^(-xi t), |e^(A t) L| <= rho_d e^(-xi_d t)."""

    rho: float
    xi: float  # 1/s
    rho_d: float  # 1/s
    xi_d: float  # 1/s

    def threshold(self, t: Array, start: float, bound: float, lipschitz: float, others: float) -> Array:
        """(10) less the bound d of the last reading, the integral in closed form.

        t: s since the start; start: bound of the first error; bound: d of the state's own sensor; lipschitz: Lambda, of h by
        the state, 1/s; others: lambda_h d_chi of (10b), the effect on h of the noise in the other readings, per s.
        """
        rho, xi, rho_d, xi_d = self
        first, noise, field = rho * start, rho_d * bound / xi_d, rho * others / xi
        fast, slow = np.exp(-xi * t), np.exp(-xi_d * t)
        effect = first * fast + noise * (1 - slow) + field * (1 - fast)
        noise_memory = t * fast if xi == xi_d else (slow - fast) / (xi - xi_d)
        memory = (first - field) * t * fast + (noise + field) * (1 - fast) / xi - noise * noise_memory
        return np.asarray(effect + rho * lipschitz * memory)


@dataclass(frozen=True, eq=False)
class Modules:
    """Scalar equations that monitoring modules compare with sensors.

    Parameters
    ----------
    equations : mapping of str to callable
        {variable: function}, the states first: h of dx/dt = -rate x + h, then phi of z = phi. Arguments are the names of
        variables and inputs, and c.
    rates : array (S,)
        Of the states, 1/s.
    nominal : mapping of str to float
        {variable: value}, SI.
    parameters : any
        c.
    inputs : tuple of str
        Their names.
    names : mapping of str to str
        {variable: name of its module}.
    gains : mapping of str to float
        {state: L of its observer, 1/s}.
    observer_bounds : mapping of str to ObserverBound, default {}
        {state: constants of (10) as published}.
    margins : mapping of str to float, default {}
        {variable: share of its nominal value by which a calibrated threshold is wider, or narrower, than the valid one}.
    drift : mapping of str to float, default {}
        {state: share of its nominal value by which it moves at most from one reading to the next}, see adaptive_threshold.
    monitor : callable, optional
        A compiled driver with the arguments after c and the result of monitoring.monitor, or None.

    Examples
    --------
    >>> from fusion_sfdia.plants import Modules, two_tanks
    >>> modules: Modules = two_tanks().structure.modules
    >>> modules.states, modules.variables
    (('level_1', 'level_2'), ('level_1', 'level_2', 'flow_12', 'flow_out', 'inflow'))
    """

    equations: Mapping[str, Callable[..., Any]]
    rates: Array
    nominal: Mapping[str, float]
    parameters: Any
    inputs: tuple[str, ...]
    names: Mapping[str, str]
    gains: Mapping[str, float]
    observer_bounds: Mapping[str, ObserverBound] = field(default_factory=dict)
    margins: Mapping[str, float] = field(default_factory=dict)
    drift: Mapping[str, float] = field(default_factory=dict)
    monitor: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        if not self.equations:
            raise ValueError("there are no equations; give one for each measured variable")
        known = {*self.equations, *self.inputs, "c"}
        for variable, function in self.equations.items():
            if unknown := [a for a in argument_names(function) if a not in known]:
                raise ValueError(f"the equation of {variable} has the unknown arguments {', '.join(unknown)}")
        for what, named in (("nominal", self.nominal), ("names", self.names)):
            if missing := [v for v in self.equations if v not in named]:
                raise ValueError(f"{what} lacks {', '.join(missing)}; expected one for each equation")
        for variable, rate in zip(self.states, self.rates, strict=True):
            gain = self.gains.get(variable, np.nan)
            if not (np.isfinite(gain) and rate + gain > 0):
                raise ValueError(
                    f"the observer of {variable} has the gain {gain} 1/s and the rate {rate} 1/s; their sum must be positive, "
                    "or its error grows"
                )

    @property
    def states(self) -> tuple[str, ...]:
        """The variables with an observer."""
        return tuple(self.equations)[: len(self.rates)]

    @property
    def variables(self) -> tuple[str, ...]:
        """All variables in the order of the equations, then the inputs."""
        return (*self.equations, *self.inputs)
