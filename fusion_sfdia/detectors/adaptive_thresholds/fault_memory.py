"""The memory of virtual sensors: isolated sensors, intervals of their faults, and readings without the faults.

A sensor with a constant offset f reads y = z + n + f with |n| <= d. With bounds of the healthy value, z in [lower, upper], f is
in y - [lower, upper] + [-d, d] at each step, and in the intersection of these intervals over time. See virtual_sensors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


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
