"""Adaptive observer: a state and the constant fault of its own sensor, estimated together (V22, sec. 4.1, (12), (13)).

V22: Kougiatsos and Reppa 2022, "A distributed virtual sensor scheme for marine fuel engines", IFAC-PapersOnLine 55-31, 333-338.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class Estimates(NamedTuple):
    """Of a state, its sensitivity Omega to the fault's estimate, and the fault: arrays (...) of one shape."""

    state: Array
    omega: Array
    fault: Array


class Rates(NamedTuple):
    """Of a state and its observer, all in 1/s: its own rate of decay, the gain L, and the learning rate Gamma."""

    rate: float
    gain: float
    learning: float


def adapt(now: Estimates, h: Array, before: Array, reading: Array, active: Array, dt: float, rates: Rates) -> Estimates:
    """Return the estimates a step of dt seconds later, of x' = -rate x + h with the readings y = x + f before and after it.

        x^' = -rate x^ + h + L (y - x^ - f^) + Omega f^'    Omega' = -(rate + L) Omega - L
        f^' = Gamma (Omega + 1) D (y - x^ - f^)

    with L and Gamma of the rates; D: active, bool. The linear part is exact for h and y held over
    the step, the adaptive law is Euler's. Readings that are NaN correct nothing.
    """
    rate, gain, learning = rates
    known = np.isfinite(before)
    correction = np.where(known, gain, 0.0)
    a = rate + correction
    lam = np.exp(-a * dt)
    held = (1 - lam) / a
    state = lam * now.state + held * (h + correction * (np.where(known, before, 0.0) - now.fault))
    omega = lam * now.omega - held * correction
    innovation = reading - state - now.fault
    change = np.where(active & np.isfinite(innovation), dt * learning * (omega + 1) * innovation, 0.0)
    return Estimates(state + omega * change, omega, now.fault + change)


def adaptive_rate(rates: Rates) -> float:
    """Return Gamma (1 + Omega)^2, 1/s, with Omega = -L / (rate + L) once it has settled: how fast the fault's error decays.

    The innovation is (1 + Omega)(f - f^) then: a gain far above the rate makes the observer follow the faulty reading.
    """
    rate, gain, learning = rates
    return learning * (rate / (rate + gain)) ** 2
