"""Detector: observers and algebraic residuals with adaptive thresholds, and diagnosis sets from their decisions.

Kougiatsos and Reppa 2024 (K24). A monitoring module compares the sensor of one variable with the equation that computes it.
A state has a Luenberger observer (6), here in discrete time: exact for the linear part, with h and the reading y held over a
step,

    x+ = lam x + (1 - lam)/a (h + L y),   a = rate + L,   lam = exp(-a dt),

An algebraic variable has its equation over the box of readings, (11)-(13); its residual is y less the middle of that interval,
in place of y (5) or -xi at the readings (K22 (27)), and decides alike. A threshold bounds the effect of noise within the
sensors' bounds d. The state's error e obeys

    |e|+ <= lam |e| + (1 - lam)/a (sup |h - h(true)| + L d) + moved,   |y - x| <= |e| + d

where `moved` bounds the change of the state within a step (see monitoring). The supremum, and the interval of an algebraic
residual, come from the corners of the equation over the box of true values that the readings allow (`corner_bounds`).
Disturbances eta_x, eta_z, bounded by Assumption 1 of Kougiatsos 2022 (K22), have no part in it, nor in the papers' thresholds.

No false alarm is possible as long as the plant obeys its equations, readings are within their bounds, variables are within the
envelope and monotone over one step, and states move by no more than their `drift`. h is evaluated at the middle of the two
readings of a step; its box contains both. For a missing reading the box is the whole envelope. Readings at which an equation
has no value are moved into the envelope for that equation.

With `observer_bounds` the thresholds of the observers are (10) with given constants, as published. Their Lipschitz constants
are slopes at the nominal point, as an equation with an infinite slope within the box has none: Lambda = |dh/dx|, and for
lambda_h d_chi the sum of |dh/dv| d over all other readings v of h, also local ones, which d_chi leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.derivatives.equation import COMPLEX_STEP, plain
from fusion_sfdia.detectors.adaptive_thresholds.algebraic_bounds import METHODS, enclosed
from fusion_sfdia.detectors.adaptive_thresholds.corner_bounds import Slopes, prove
from fusion_sfdia.detectors.adaptive_thresholds.diagnosis_sets import DiagnosisLogic, module_logic
from fusion_sfdia.detectors.adaptive_thresholds.monitored_plant import (
    envelope_ends,
    modules_of,
    require_one_bounded_sensor_each,
)
from fusion_sfdia.detectors.adaptive_thresholds.monitoring import Settings, decide, monitor, quantities_of
from fusion_sfdia.detectors.batch_detector import BatchDetector, TimeStep, without_false_alarms
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.plant.modules import Modules, ObserverBound

Array = NDArray[Any]


class MonitoringMemory(NamedTuple):
    """Memory in SI units. States (..., S) and variables (..., E) are in the order of the equations.

    x, error: (..., S) the observers' estimates and bounds of their errors. reading: (..., E) the last readings, NaN where
    missing. fired: (..., N) modules that have fired, in the order of the sensors. elapsed: (...) s since the start.
    """

    x: Array
    error: Array
    reading: Array
    fired: Array
    elapsed: Array


@dataclass(frozen=True)
class AdaptiveThreshold(BatchDetector):
    """Monitoring modules of a plant whose `modules` state its equations; hypotheses are the sensors.

    Parameters
    ----------
    envelope : float or mapping of str to (float, float), optional
        The range of healthy readings. A number: half of its width as a share of the nominal values. {variable: (least, most)}
        in SI is for variables that change with the load; include twice the noise bound on either side. Default: twice the
        largest noise bound plus 5 %. A varying load needs an envelope as wide as its transients; otherwise an alarm does not
        prove a fault.
    drift : mapping of str to float, optional
        {state: share of its nominal value by which it moves at most in one plant.dt}. Default: the values of the plant's
        modules, for a steady load. Give it for a load that varies, even within the envelope (for loads of the engine within 3 %
        marine_engine.receiver_drift). For other states the model and the readings bound the drift.
    bounds : str, default "corners"
        Of algebraic variables: "corners"; "inclusion", interval arithmetic through the equation, K22 (36); "sivia", set
        inversion, K24 (11); or "codac", set inversion by that library. The alternatives are wider and slow.
    observer_bounds : mapping of str to ObserverBound, default {}
        {state: the constants of its observer's threshold (10), as published}.
    margins : mapping of str to float, default {}
        {variable: share of its nominal value} added to its threshold.
    latch : bool, default True
        The decision of a module that has fired stays, (16).
    agents : bool, default True
        Whether an agent exonerates its own sensors while none of its modules fires, (17), (18).

    Notes
    -----
    Equations: Kougiatsos and Reppa 2024 (K24), and Kougiatsos 2022 (K22) where named.

    isolated: the members of all diagnoses, which may be most sensors; no sensor where no set of faults explains the modules
    that fire. The reconstruction keeps the readings of isolated sensors. The fault size is the residual; for an observer it is
    only the part of the fault that the observer has not followed.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import AdaptiveThreshold
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = AdaptiveThreshold(two_tanks())
    >>> recording = simulate(detector.plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.5, 0.0, 0.0, 0.0]
    >>> decisions = run(detector, detector.init(), recording.t, y, recording.u)[1]
    >>> int(decisions.alarm.argmax()), decisions.isolated[-1].tolist()
    (20, [True, False, True, False])
    """

    envelope: float | Mapping[str, tuple[float, float]] | None = None
    drift: Mapping[str, float] | None = None
    bounds: str = "corners"
    observer_bounds: Mapping[str, ObserverBound] = field(default_factory=dict)
    margins: Mapping[str, float] = field(default_factory=dict)
    latch: bool = True
    agents: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        modules, plant = self._modules, self.plant
        require_one_bounded_sensor_each(plant, modules)
        if self.bounds not in METHODS:
            raise ValueError(f"bounds is {shown(self.bounds)}; known: {', '.join(METHODS)}")
        for what, known in (("observer_bounds", modules.states), ("drift", modules.states), ("margins", modules.equations)):
            if unknown := [v for v in getattr(self, what) or () if v not in known]:
                raise ValueError(f"{what} has {', '.join(unknown)}; expected some of {', '.join(known)}")
        if isinstance(self.envelope, Mapping) and (unknown := [v for v in self.envelope if v not in modules.equations]):
            raise ValueError(f"envelope has {', '.join(unknown)}; expected some of {', '.join(modules.equations)}")

    @property
    def claimed_rate(self) -> float:
        """0 at a steady load with thresholds that bounded noise cannot cross: without published bounds and margins."""
        if self.fitted_rate is not None or self.observer_bounds or self.margins or self.threshold_scale < 1:
            return super().claimed_rate
        return without_false_alarms(self.plant)

    @property
    def _modules(self) -> Modules:
        return modules_of(self.plant)

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
    def ends(self) -> tuple[Array, Array]:
        """Least and largest healthy readings by variable (E,), SI."""
        return envelope_ends(self._modules, self.nominal, self._bound, self.envelope)

    @cached_property
    def half_width(self) -> Array:
        """Half-width of the envelope by variable (E,), SI."""
        return (self.ends[1] - self.ends[0]) / 2

    @cached_property
    def slopes(self) -> Slopes:
        """Signs of the equations' slopes, proved over the envelope (and all values of the inputs)."""
        m, inputs = self._modules, self.plant.inputs
        low = np.concatenate([self.ends[0], [s.low for s in inputs]])
        high = np.concatenate([self.ends[1], [s.high for s in inputs]])
        return prove(m.equations, m.variables, low, high, m.parameters)

    @cached_property
    def _steepness(self) -> Array:
        """|dh/dv| of each state's equation by each variable at the nominal point (S, E), in units of the state per v and s."""
        m = self._modules
        at = dict(m.nominal) | {s.name: s.nominal for s in self.plant.inputs}
        moved: list[dict[str, Any]] = [{**at, v: at[v] + 1j * COMPLEX_STEP} for v in m.equations]
        laws = [m.equations[v] for v in m.states]
        rates = [[h(*(p[a] for a in quantities_of(h)), m.parameters) for p in moved] for h in laws]
        return np.asarray(np.abs(np.imag(rates)) / COMPLEX_STEP)

    @cached_property
    def _others(self) -> list[float]:
        """lambda_h d_chi of each state (S): the effect on its equation of the noise in all readings but its own, per s."""
        return [float(np.delete(slopes * self._bound, e).sum()) for e, slopes in enumerate(self._steepness)]

    @cached_property
    def logic(self) -> DiagnosisLogic:
        """Signature matrices from the equations' arguments: 1 for an observer's own sensor, * for other sensors it reads."""
        return module_logic(self.plant, self._modules, agents=self.agents)

    @cached_property
    def _settings(self) -> Settings:
        m, slopes = self._modules, self.slopes
        middle, shares = np.mean(self.ends, axis=0), m.drift if self.drift is None else self.drift
        widest = 2 * self.half_width / np.abs(self.nominal)
        drift = np.array([shares.get(v, widest[e]) * abs(m.nominal[v]) for e, v in enumerate(m.states)]) / self.plant.dt
        rates, gains = np.asarray(m.rates, float), np.array([m.gains[v] for v in m.states])
        return Settings(middle, self.half_width, self._bound, rates, gains, slopes.signs, slopes.unproved, drift)

    @cached_property
    def _monitor(self) -> Callable[..., Any]:
        m = self._modules
        return m.monitor or partial(monitor, m)

    @cached_property
    def _layers(self) -> tuple[Array, Array, Array]:
        """Arguments of `decide`: what it adds to the radii by variable (E,), variable and scale of each sensor (N,)."""
        margin = np.array([self.margins.get(v, 0.0) for v in self._modules.equations]) * np.abs(self.nominal)
        scale = np.broadcast_to(self.plant.sensor_scale, self._sensor.shape).copy()
        return self._bound + margin, self._variable, scale

    def _start(self, batch: tuple[int, ...], seed: int) -> MonitoringMemory:
        count, e = len(self._modules.states), len(self.nominal)
        middle, unknown, silent = np.mean(self.ends, axis=0)[:count], np.full(e, np.nan), np.zeros(e, bool)
        start = MonitoringMemory(middle, self.half_width[:count], unknown, silent, np.zeros(()))
        return MonitoringMemory(*(np.broadcast_to(a, (*batch, *a.shape)).copy() for a in start))

    def _readmitted(self, memory: MonitoringMemory, t: float, which: Array) -> MonitoringMemory:
        """Modules that read these sensors have not fired; their observers restart from the envelope."""
        m, states = self._modules, len(self._modules.states)
        variables = list(m.equations)
        chosen = {variables[self._variable[i]] for i in np.flatnonzero(which)}
        reads = np.array([v in chosen or bool(chosen & {*quantities_of(m.equations[v])}) for v in variables])
        middle = np.mean(self.ends, axis=0)
        return memory._replace(
            x=np.where(reads[:states], middle[:states], memory.x),
            error=np.where(reads[:states], self.half_width[:states], memory.error),
            fired=memory.fired & ~reads[self._variable],
        )

    def _judge(self, memory: MonitoringMemory, now: TimeStep, y: Array, u: Array) -> tuple[MonitoringMemory, Decision]:
        x, error, before, fired, elapsed = memory
        extra, variable, scale = self._layers
        y = plain(y)
        reading = (y / scale).take(self._sensor, axis=-1)
        x, error, lower, upper = self._monitor(x, error, before, reading, u, now.dt, self._settings)
        if self.bounds != "corners":
            lower, upper = enclosed(self.bounds, self._modules, reading, u, self._settings)
        elapsed = elapsed + now.dt
        radius = self._published(error, elapsed) if self.observer_bounds else error
        if not self.latch:
            fired = np.zeros_like(fired)
        residual, threshold, reconstruction, fired, lost = decide(
            y, x, radius, lower, upper, extra, variable, scale, fired, float(self.threshold_scale)
        )
        isolated = self.logic.isolated(fired)
        decision = Decision(
            estimate=x,
            reconstruction=reconstruction,
            residual=residual,
            threshold=threshold,
            isolated=isolated,
            fault_size=np.where(isolated, residual, np.nan),
            diverged=lost,
            guarded=np.zeros(lost.shape, bool),
            nis=np.full(lost.shape, np.nan),
        )
        return MonitoringMemory(x, error, reading, fired, elapsed), decision

    def _published(self, error: Array, t: Array) -> Array:
        """Bounds of the states' errors (B, S) at t (B,) since the start: (10) less the noise where constants are given."""
        error = error.copy()
        for e, variable in enumerate(self._modules.states):
            if variable in self.observer_bounds:
                c, start = self.observer_bounds[variable], self.half_width[e]
                error[:, e] = c.threshold(t, start, self._bound[e], self._steepness[e, e], self._others[e])
        return error
