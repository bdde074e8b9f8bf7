"""Detector: observers and algebraic residuals with adaptive thresholds, and diagnosis sets from their decisions.

Kougiatsos and Reppa 2024 (K24). A module compares the sensor of one variable with the equation that computes it. A state
has a Luenberger observer (6), here sampled: exact for its linear part, with h held over a step,

    x+ = lam x + (1 - lam)/a (h + L y),   a = rate + L,   lam = exp(-a dt),

an algebraic variable its equation at the readings, (11)-(13). A threshold bounds what noise within the sensors' bounds d can
do: the state's error e obeys

    |e|+ <= lam |e| + (1 - lam)/a (sup |h - h(true)| + L d),   |y - x| <= |e| + d

and the supremum, as the interval of an algebraic residual, comes from the corners of the equation over the box that the
readings leave to the truth (`corner_bounds`). No false alarm is possible while readings are within their bounds, variables
within the envelope and, over one step, monotone: h is taken at the mean of the two readings of a step, its box holds both.
A missing reading leaves the whole envelope.

With `observer_bounds` the thresholds of the observers are (10) with given constants instead, as published. The Lipschitz
constant of (10) is the slope at the nominal point there: a law with an infinite slope within the box has none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.batch_detector import BatchDetector, Moment
from fusion_sfdia.corner_bounds import Slopes, prove
from fusion_sfdia.detector import Decision, State
from fusion_sfdia.diagnosis_sets import DiagnosisLogic
from fusion_sfdia.equation import COMPLEX_STEP, argument_names
from fusion_sfdia.modules import Modules, ObserverBound
from fusion_sfdia.monitoring import Settings, monitor
from fusion_sfdia.signatures import Agent, local_signatures, sensors_read

Array = NDArray[Any]

ENVELOPE = 0.05  # of the nominal values, beyond twice the noise, in which healthy readings are taken to lie


@dataclass(frozen=True)
class AdaptiveThreshold(BatchDetector):
    """Monitoring modules of a plant whose `modules` say its equations; hypotheses are the sensors.

    envelope: half-width of the range of healthy readings, as a share of the nominal values; None: twice the largest noise
    bound, and 5 %. margins: {variable: share of its nominal value} added to its threshold. latch: a module that has fired
    stays fired, (16). agents: whether the silence of all modules of a block clears its own sensors, (17), (18).
    """

    envelope: float | None = None
    observer_bounds: Mapping[str, ObserverBound] = field(default_factory=dict)
    margins: Mapping[str, float] = field(default_factory=dict)
    latch: bool = True
    agents: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        modules, plant = self._modules, self.plant
        measured = [s.measures for s in plant.sensors]
        if sorted(measured) != sorted(modules.equations):
            raise ValueError(
                f"plant {plant.name!r} has sensors of {', '.join(measured)}, equations of {', '.join(modules.equations)}; "
                "wanted one sensor for each equation"
            )
        if unbounded := [s.name for s in plant.sensors if not np.isfinite(s.noise_bound)]:
            raise ValueError(f"sensors {', '.join(unbounded)} have no noise bound; an adaptive threshold needs one: give bound")
        for what in ("observer_bounds", "margins"):
            if unknown := [v for v in getattr(self, what) if v not in modules.equations]:
                raise ValueError(f"{what} names {', '.join(unknown)}; the equations are of {', '.join(modules.equations)}")

    @property
    def _modules(self) -> Modules:
        if self.plant.modules is None:
            raise ValueError(
                f"plant {self.plant.name!r} does not say its scalar equations; give Plant(modules=Modules(...)) or take "
                "another detector"
            )
        return self.plant.modules

    @cached_property
    def _sensor(self) -> Array:
        """The sensor of each variable (E,)."""
        names = [s.measures for s in self.plant.sensors]
        return np.array([names.index(v) for v in self._modules.equations])

    @cached_property
    def _variable(self) -> Array:
        """The variable of each sensor (N,)."""
        return np.argsort(self._sensor)

    @cached_property
    def _bound(self) -> Array:
        """Noise bounds by variable (E,), SI."""
        return (np.array([s.noise_bound for s in self.plant.sensors]) / np.abs(self.plant.sensor_scale))[self._sensor]

    @cached_property
    def nominal(self) -> Array:
        """Nominal values by variable (E,), SI."""
        return np.array([self._modules.nominal[v] for v in self._modules.equations])

    @cached_property
    def half_width(self) -> Array:
        """Half-width of the envelope by variable (E,), SI."""
        share = self.envelope
        if share is None:
            share = 2 * float(np.max(self._bound / np.abs(self.nominal))) + ENVELOPE
        return share * np.abs(self.nominal)

    @cached_property
    def slopes(self) -> Slopes:
        """Signs of the equations' slopes, proved over the envelope (and all values of the inputs)."""
        m = self._modules
        ends = [(s.low, s.high) for s in self.plant.inputs]
        low = np.concatenate([self.nominal - self.half_width, [e[0] for e in ends]])
        high = np.concatenate([self.nominal + self.half_width, [e[1] for e in ends]])
        return prove(m.equations, m.variables, low, high, m.parameters)

    @cached_property
    def _steepness(self) -> Array:
        """|dh/dx| of each state's own equation at the nominal point (S,), 1/s."""
        m = self._modules
        at = dict(m.nominal) | {s.name: s.nominal for s in self.plant.inputs}
        moved: list[dict[str, Any]] = [{**at, v: at[v] + 1j * COMPLEX_STEP} for v in m.states]
        rates = [m.equations[v](*(p[a] for a in named(m, v)), m.parameters) for v, p in zip(m.states, moved, strict=True)]
        return np.asarray(np.abs(np.imag(rates)) / COMPLEX_STEP)

    @cached_property
    def logic(self) -> DiagnosisLogic:
        """Signature matrices from the arguments of the equations: 1 for an observer's own sensor, * for the others read."""
        m, plant = self._modules, self.plant
        sensor = {s.measures: s.name for s in plant.sensors}
        named = {m.names[s.measures]: (s.measures, *argument_names(m.equations[s.measures])) for s in plant.sensors}
        reads = sensors_read(named, sensor, known=(*m.inputs, "c"))
        local = local_signatures(reads, {m.names[v]: (sensor[v],) for v in m.states}, plant.sensor_names)
        owners = dict.fromkeys(s.owner for s in plant.sensors)
        agents = {
            owner: Agent(
                tuple(m.names[s.measures] for s in plant.sensors if s.owner == owner),
                tuple(s.name for s in plant.sensors if s.owner == owner),
            )
            for owner in owners
        }
        return DiagnosisLogic(local, agents if self.agents else None)

    @cached_property
    def _settings(self) -> Settings:
        m, slopes = self._modules, self.slopes
        return Settings(
            self.nominal, self.half_width, self._bound, np.asarray(m.rates, float), self._gains, slopes.signs, slopes.unproved
        )

    @cached_property
    def _monitor(self) -> Callable[..., Any]:
        m = self._modules
        return m.monitor or partial(monitor, m.equations, m.variables, m.parameters)

    @cached_property
    def _margin(self) -> Array:
        return np.array([self.margins.get(v, 0.0) for v in self._modules.equations]) * np.abs(self.nominal)

    @cached_property
    def _gains(self) -> Array:
        return np.array([self._modules.gains[v] for v in self._modules.states])

    def _start(self, batch: tuple[int, ...], seed: int) -> State:
        """Estimates x (S,) and bounds of their errors, the last readings by variable (E,), modules that have fired (N,)."""
        s = len(self._gains)
        return (
            np.broadcast_to(self.nominal[:s], (*batch, s)).copy(),
            np.broadcast_to(self.half_width[:s], (*batch, s)).copy(),
            np.full((*batch, len(self.nominal)), np.nan),
            np.zeros((*batch, len(self.nominal)), bool),
        )

    def _judge(self, core: State, now: Moment, y: Array, u: Array) -> tuple[State, Decision]:
        shape = y.shape[:-1]
        x, error, before, fired = (a.reshape(-1, a.shape[-1]) for a in core)
        reading = np.array((y / self.plant.sensor_scale)[..., self._sensor].reshape(len(x), -1), order="C")
        u = np.array(u.reshape(len(x), -1), order="C")
        s = x.shape[1]
        x, error, lower, upper = self._monitor(x, error, before, reading, u, now.dt, self._settings)
        predicted = np.concatenate([x, (lower + upper) / 2], axis=-1)
        radius = np.concatenate([self._state_bound(error, now), (upper - lower) / 2], axis=-1)
        threshold = radius + self._bound + self._margin
        residual = reading - predicted
        scale = self.plant.sensor_scale
        back = self._variable
        residual, threshold = residual[:, back] * scale, threshold[:, back] * np.abs(scale)
        with np.errstate(invalid="ignore"):
            firing = np.abs(residual) > threshold
        fired = firing | fired if self.latch else firing
        isolated = self.logic.isolated(fired)
        decision = Decision(
            estimate=x.reshape(*shape, s),
            measured=np.where(np.isfinite(y), y, (predicted[:, back] * scale).reshape(y.shape)),
            residual=residual.reshape(y.shape),
            threshold=threshold.reshape(y.shape),
            isolated=isolated.reshape(y.shape),
            fault_size=np.where(isolated, residual, np.nan).reshape(y.shape),
            diverged=~np.all(np.isfinite(predicted), axis=-1).reshape(shape),
            guarded=np.zeros(shape, bool),
            nis=np.full(shape, np.nan),
        )
        return tuple(a.reshape(*shape, -1) for a in (x, error, reading, fired)), decision

    def _state_bound(self, error: Array, now: Moment) -> Array:
        """What bounds the states' errors (B, S): the recursion's, or (10) less the noise where constants are given."""
        for e, variable in enumerate(self._modules.states):
            if variable in self.observer_bounds:
                c, d, t = self.observer_bounds[variable], self._bound[e], now.k * now.dt
                lipschitz = self._steepness[e]
                start, noise, field = c.rho * self.half_width[e], c.rho_d * d / c.xi_d, c.rho * lipschitz * d / c.xi
                fast, slow = np.exp(-c.xi * t), np.exp(-c.xi_d * t)
                effect = start * fast + noise * (1 - slow) + field * (1 - fast)
                memory = start * t * fast + (noise + field) * (1 - fast) / c.xi - field * t * fast
                memory -= noise * (slow - fast) / (c.xi - c.xi_d)
                error = error.copy()
                error[:, e] = effect + c.rho * lipschitz * memory
        return error


def named(modules: Modules, variable: str) -> list[str]:
    """The variables and inputs that the equation of a variable takes."""
    return [a for a in argument_names(modules.equations[variable]) if a != "c"]
