"""Detector: virtual sensors, which estimate a sensor's fault and send the reading without it to the other modules (V22).

V22: Kougiatsos and Reppa 2022, "A distributed virtual sensor scheme for marine fuel engines", IFAC-PapersOnLine 55-31, 333-338.
Thresholds are those of `adaptive_threshold`. When the module of a sensor fires (D = 1 in V22), the sensor is assumed to have a
constant offset f from then on. Its equation at the other readings bounds the healthy value, z in [lower, upper]; the observer
of a state runs without its correction by that sensor. With noise within d,

    f  in  y - [lower, upper] + [-d, d]                                                     (16), see below

at each step, and in the intersection of these intervals over time. The middle is the estimate (17), and y_H = y - f^ is the
reconstructed reading (11). The other modules receive y_H with the remaining interval in its noise bound, so that their
thresholds remain guaranteed. An empty intersection means that the sensor has no constant offset, or that another sensor is
faulty, too; the reading then counts as missing.

As printed, (16) adds d where it must be subtracted; the middle is the same. V22 states no intersection over time, but shows an
interval that narrows (its Fig. 4(d)), which intervals of single instants do not.

If several modules fire at once, the isolated sensor is the one without which the fewest modules fire (V22 does not treat
this case): the other modules may fire only because they read it. Everything computed from its readings is reset: observers
restart from the envelope, and intervals that depend on it restart. If a fault first exceeds the threshold of another sensor's
module, that sensor is isolated falsely: intervals are guaranteed only where every faulty sensor is isolated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_observer import Estimates, Rates, adapt
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.adaptive_thresholds.algebraic_bounds import enclosure
from fusion_sfdia.detectors.adaptive_thresholds.monitoring import Settings, box, quantities_of
from fusion_sfdia.detectors.batch_detector import BatchDetector, TimeStep, without_false_alarms
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.state import State
from fusion_sfdia.plant.modules import Modules

Array = NDArray[Any]

INVERSIONS = ("corners", "sivia")


class ModuleBounds(NamedTuple):
    """Observers after the step, x and error (B, S); bounds of each healthy value and whether its module fires (B, E)."""

    x: Array
    error: Array
    low: Array
    high: Array
    firing: Array

    def where(self, condition: Array, other: ModuleBounds) -> ModuleBounds:
        """Return these runs where the condition (B,) holds, those of `other` elsewhere."""
        return ModuleBounds(*(np.where(condition[:, None], a, b) for a, b in zip(self, other, strict=True)))


@dataclass(frozen=True)
class VirtualSensors(BatchDetector):
    """Fault sizes and reconstructed readings on a plant whose `modules` state its equations; hypotheses are the sensors.

    Parameters
    ----------
    envelope : float or mapping of str to (float, float), optional
        As of AdaptiveThreshold.
    drift : mapping of str to float, optional
        As of AdaptiveThreshold.
    learning_rates : mapping of str to float, default {}
        {state: Gamma, 1/s} for states whose fault an adaptive observer (12) estimates, with the gain of their module. Its
        estimate is not guaranteed; the interval is.
    intersect : bool, default True
        False for the interval of each instant alone, as (17) is printed. (14) has the equation's value at the readings in place
        of the middle.
    inversion : str, default "corners"
        "corners", or "sivia" for set inversion (15) of the algebraic equations of isolated sensors, which is slow.

    Notes
    -----
    isolated: sensors whose own module has fired, given the reconstructed readings of the other sensors; they stay isolated.
    fault_size: the middle of the fault's interval, or the estimate of the adaptive observer; the residual where no constant
    offset fits. reconstruction: the readings without the faults; the value of the equation where a reading is missing or no
    constant offset fits.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import VirtualSensors
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = VirtualSensors(two_tanks())
    >>> recording = simulate(detector.plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.5, 0.0, 0.0, 0.0]
    >>> decisions = run(detector, detector.init(), recording.t, y, recording.u)[1]
    >>> decisions.isolated[-1].tolist(), round(float(decisions.fault_size[-1, 0]), 1)
    ([True, False, False, False], 0.5)
    """

    envelope: float | Mapping[str, tuple[float, float]] | None = None
    drift: Mapping[str, float] | None = None
    learning_rates: Mapping[str, float] = field(default_factory=dict)
    intersect: bool = True
    inversion: str = "corners"

    def __post_init__(self) -> None:
        super().__post_init__()
        modules = self._modules
        if self.inversion not in INVERSIONS:
            raise ValueError(f"inversion is {self.inversion!r}; known: {', '.join(INVERSIONS)}")
        if unknown := [v for v in self.learning_rates if v not in modules.states]:
            raise ValueError(f"learning_rates has {', '.join(unknown)}; the states are {', '.join(modules.states)}")
        if wrong := [f"{v}={g}" for v, g in self.learning_rates.items() if not (np.isfinite(g) and g > 0)]:
            raise ValueError(f"learning rates {', '.join(wrong)}; expected positive numbers in 1/s")

    @property
    def claimed_rate(self) -> float:
        """0 with thresholds that bounded noise cannot cross."""
        if self.fitted_rate is not None or self.threshold_scale < 1:
            return super().claimed_rate
        return without_false_alarms(self.plant)

    def fault_interval(self, state: State) -> Interval:
        """Return the intervals of the sensors' constant offsets in sensor units, after the step that returned `state`.

        Parameters
        ----------
        state : State
            Of this detector.

        Returns
        -------
        Interval (*batch, N)
            -inf to inf for a sensor that is not isolated, empty where no constant offset fits.
        """
        self._batch_of(state)
        m, of = state.memory, self.thresholds
        a, b = (end[..., of._variable] * self.plant.sensor_scale for end in (m.low, m.high))
        return Interval.unchecked(np.minimum(a, b), np.maximum(a, b))

    @cached_property
    def thresholds(self) -> AdaptiveThreshold:
        """The detector with the same modules and thresholds."""
        return AdaptiveThreshold(self.plant, envelope=self.envelope, drift=self.drift)

    @property
    def _modules(self) -> Modules:
        return self.thresholds._modules

    @property
    def _settings(self) -> Settings:
        return self.thresholds._settings

    @cached_property
    def _depends_on(self) -> Array:
        """Whether the value of equation e depends on the reading of variable j (E, E), directly or through others."""
        m = self._modules
        reads = np.array([[v == w or w in quantities_of(m.equations[v]) for w in m.equations] for v in m.equations])
        return np.linalg.matrix_power(reads.astype(float), len(reads)) > 0

    def _start(self, batch: tuple[int, ...], seed: int) -> FaultMemory:
        s = self._settings
        return FaultMemory.new(batch, s.nominal, s.half_width, len(s.gains))

    def _readmitted(self, memory: FaultMemory, t: float, which: Array) -> FaultMemory:
        """No interval of their faults; the modules that depend on these sensors restart as at an isolation."""
        s = self._settings
        for i in np.flatnonzero(which):
            e = int(self.thresholds._variable[i])
            memory = memory.without(e, self._depends_on[:, e], s.nominal, s.half_width)
            own = np.arange(len(self._depends_on)) == e
            memory = memory._replace(isolated=memory.isolated & ~own, before=np.where(own, np.nan, memory.before))
        return memory

    def _judge(self, memory: FaultMemory, now: TimeStep, y: Array, u: Array) -> tuple[FaultMemory, Decision]:
        m, runs, scale, of = memory, len(y), self.plant.sensor_scale, self.thresholds
        reading = np.ascontiguousarray((y / scale)[:, of._sensor])
        bounds = self._step_modules(m, reading, u, now.dt)
        while np.any(fresh := bounds.firing & ~m.isolated):
            m, bounds = self._isolate(m, bounds, fresh, reading, u, now.dt)
        m = self._after(m, bounds, reading, u, now.dt)
        middle, radius = (bounds.low + bounds.high) / 2, (bounds.high - bounds.low) / 2
        residual, threshold = reading - middle, self.threshold_scale * (radius + self._settings.bound)
        size = np.where(np.isfinite(m.size), m.size, residual)
        usable = np.isfinite(reading) & ~(m.isolated & np.isnan(m.size))
        healthy = np.where(usable, reading - np.where(m.isolated, size, 0.0), middle)
        of_sensors = (a[:, of._variable] for a in (healthy, residual, np.where(m.isolated, size, np.nan)))
        healthy, residual, size = (a * scale for a in of_sensors)
        isolated = m.isolated[:, of._variable]
        decision = Decision(
            estimate=bounds.x,
            reconstruction=np.where(np.isfinite(y) & ~isolated, y, healthy),
            residual=residual,
            threshold=threshold[:, of._variable] * np.abs(scale),
            isolated=isolated,
            fault_size=size,
            diverged=~np.all(np.isfinite(middle), axis=-1),
            guarded=np.zeros(runs, bool),
            nis=np.full(runs, np.nan),
        )
        return m, decision

    def _step_modules(self, m: FaultMemory, reading: Array, u: Array, dt: float) -> ModuleBounds:
        """A step of the modules on reconstructed readings, without correction of the observers of isolated sensors."""
        s, states = self._settings, len(self._settings.gains)
        (before, _), (healthy, bound) = (m.reconstructed(a, s.bound) for a in (m.before, reading))
        gains = np.where(m.isolated[:, :states], 0.0, s.gains)
        x, error, lower, upper = self.thresholds._monitor(
            m.x, m.error, before, healthy, u, dt, s._replace(bound=bound, gains=gains)
        )
        if self.inversion == "sivia":
            lower, upper = self._inverted(m, healthy, bound, u, lower, upper)
        low, high = np.concatenate([x - error, lower], axis=-1), np.concatenate([x + error, upper], axis=-1)
        firing = np.abs(reading - (low + high) / 2) > self.threshold_scale * ((high - low) / 2 + s.bound)
        return ModuleBounds(x, error, low, high, firing)

    def _inverted(
        self, m: FaultMemory, healthy: Array, bound: Array, u: Array, lower: Array, upper: Array
    ) -> tuple[Array, Array]:
        """The bounds (B, E - S), for isolated sensors by set inversion where it finds a solution."""
        s, states = self._settings, len(self._settings.gains)
        low, high = box(healthy, healthy, u, s._replace(bound=bound))
        lower, upper = lower.copy(), upper.copy()
        for e, variable in enumerate(self._modules.equations):
            rows = np.flatnonzero(m.isolated[:, e]) if e >= states else np.empty(0, int)
            if rows.size:
                found = enclosure("sivia", self._modules, variable, low[rows], high[rows], s)
                slack = s.rounding * np.maximum(np.abs(found.lo), np.abs(found.hi))
                known = np.isfinite(found.lo + found.hi)
                lower[rows, e - states] = np.where(known, found.lo - slack, lower[rows, e - states])
                upper[rows, e - states] = np.where(known, found.hi + slack, upper[rows, e - states])
        return lower, upper

    def _isolate(
        self, m: FaultMemory, bounds: ModuleBounds, fresh: Array, reading: Array, u: Array, dt: float
    ) -> tuple[FaultMemory, ModuleBounds]:
        """Isolate one of the sensors whose modules fire (B, E) in each run: the one without which the fewest modules fire."""
        s, best = self._settings, m
        fewest = np.full(len(fresh), np.iinfo(int).max)
        for e in np.flatnonzero(fresh.any(axis=0)):
            tried = m.without(int(e), self._depends_on[:, e], s.nominal, s.half_width)
            seen = self._step_modules(tried, reading, u, dt)
            left = np.where(fresh[:, e], (seen.firing & ~tried.isolated).sum(axis=-1), np.iinfo(int).max)
            better = left < fewest
            best, bounds, fewest = tried.where(better, best), seen.where(better, bounds), np.where(better, left, fewest)
        return best, bounds

    def _after(self, m: FaultMemory, bounds: ModuleBounds, reading: Array, u: Array, dt: float) -> FaultMemory:
        """The memory after the step: observers, and the faults' intervals and estimates."""
        low, high = m.interval(reading, bounds.low, bounds.high, self._settings.bound, self.intersect)
        with np.errstate(invalid="ignore"):
            size = np.where(np.isfinite(high - low), (low + high) / 2, np.nan)
        adaptive = self._adapted(m, reading, u, dt) if self.learning_rates else Estimates(m.state, m.omega, m.fault)
        for e, variable in enumerate(self._modules.states):
            if variable in self.learning_rates:
                size[:, e] = np.where(np.isfinite(size[:, e]), adaptive.fault[:, e], np.nan)
        return FaultMemory(bounds.x, bounds.error, reading, m.isolated, low, high, size, *adaptive)

    def _adapted(self, m: FaultMemory, reading: Array, u: Array, dt: float) -> Estimates:
        """The adaptive observers after the step, with the mean of the reconstructed readings before and after it as input."""
        modules, s = self._modules, self._settings
        new = [a.copy() for a in (m.state, m.omega, m.fault)]
        middle = (m.reconstructed(m.before, s.bound)[0] + m.reconstructed(reading, s.bound)[0]) / 2
        at = np.concatenate([np.where(np.isnan(middle), s.nominal, middle), u], axis=-1)
        for e, (variable, rate) in enumerate(zip(modules.states, s.rates, strict=True)):
            if variable not in self.learning_rates:
                continue
            values = dict(zip(modules.variables, at.T, strict=True)) | {variable: m.state[:, e]}
            equation = modules.equations[variable]
            h = equation(*(values[a] for a in quantities_of(equation)), modules.parameters)
            own, gamma = Estimates(m.state[:, e], m.omega[:, e], m.fault[:, e]), self.learning_rates[variable]
            after = adapt(own, h, m.before[:, e], reading[:, e], m.isolated[:, e], dt, Rates(rate, s.gains[e], gamma))
            for column, value in zip(new, after, strict=True):
                column[:, e] = value
        return Estimates(*new)


class FaultMemory(NamedTuple):
    """Arrays by state (B, S) or by variable (B, E), in SI.

    x, error (B, S): estimates of the states and bounds of their errors. before (B, E): the last readings, not reconstructed.
    isolated (B, E): bool. low, high (B, E): the fault's interval; -inf .. inf where nothing is known, NaN where no constant
    offset fits. size (B, E): estimate of the fault, NaN without one. state, omega, fault (B, S): of the adaptive observers.
    """

    x: Array
    error: Array
    before: Array
    isolated: Array
    low: Array
    high: Array
    size: Array
    state: Array
    omega: Array
    fault: Array

    @classmethod
    def new(cls, batch: tuple[int, ...], nominal: Array, half_width: Array, states: int) -> FaultMemory:
        """Return the initial memory: no sensor is isolated, and the S = `states` states are within the envelope."""
        e, s = (*batch, len(nominal)), (*batch, states)
        x, error = (np.broadcast_to(a[:states], s) for a in (nominal, half_width))
        unknown, free, nothing = np.full(e, np.nan), np.full(e, np.inf), np.zeros(s)
        return cls(
            x.copy(), error.copy(), unknown, np.zeros(e, bool), -free, free, unknown.copy(), x.copy(), nothing, nothing.copy()
        )

    def where(self, condition: Array, other: FaultMemory) -> FaultMemory:
        """Return these runs where the condition (B,) holds, those of `other` elsewhere."""
        return FaultMemory(*(np.where(condition[:, None], a, b) for a, b in zip(self, other, strict=True)))

    def reconstructed(self, reading: Array, bound: Array) -> tuple[Array, Array]:
        """Return readings without the faults, (11), and bounds of their errors (B, E); NaN where the fault is unknown.

        bound (E,): of the sensors' noise. The error of y - f^ is the noise plus f - f^, with f in [low, high].
        """
        with np.errstate(invalid="ignore"):
            width = np.maximum(self.high - self.size, self.size - self.low)
        known = self.isolated & np.isfinite(width)
        healthy = np.where(known, reading - self.size, np.where(self.isolated, np.nan, reading))
        return healthy, bound + np.where(known, width, 0.0)

    def without(self, sensor: int, touched: Array, nominal: Array, half_width: Array) -> FaultMemory:
        """Isolate a sensor and reset the intervals and observers that depend on its readings, `touched` (E,).

        The observers restart from the envelope nominal +- half_width (E,).
        """
        states = self.x.shape[-1]
        own = np.arange(len(touched)) == sensor
        lost = own | (touched & self.isolated)
        return self._replace(
            x=np.where(touched[:states], nominal[:states], self.x),
            error=np.where(touched[:states], half_width[:states], self.error),
            isolated=self.isolated | own,
            low=np.where(lost, -np.inf, self.low),
            high=np.where(lost, np.inf, self.high),
            size=np.where(lost, np.nan, self.size),
        )

    def interval(self, reading: Array, lower: Array, upper: Array, bound: Array, intersect: bool) -> tuple[Array, Array]:
        """Return the faults' intervals (B, E) after another reading whose healthy value is within lower .. upper.

        intersect: with the intervals before; otherwise the interval of this reading alone. A missing reading changes nothing.
        """
        low, high = reading - upper - bound, reading - lower + bound
        if intersect:
            low, high = np.maximum(self.low, low), np.minimum(self.high, high)
        informs = self.isolated & np.isfinite(reading)
        low, high = np.where(informs, low, self.low), np.where(informs, high, self.high)
        fits = low <= high  # False where NaN
        return np.where(fits, low, np.nan), np.where(fits, high, np.nan)
