"""Adaptive observer: joint estimation of a state and the constant fault of its own sensor (V22, sec. 4.1, (12), (13)).

V22: Kougiatsos and Reppa 2022, "A distributed virtual sensor scheme for marine fuel engines", IFAC-PapersOnLine 55-31, 333-338.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class Estimates(NamedTuple):
    """Estimate of a state, its sensitivity Omega to the fault estimate, and the fault estimate; arrays (...) of one shape."""

    state: Array
    omega: Array
    fault: Array


class Rates(NamedTuple):
    """Rate of decay of a state, gain L and learning rate Gamma of its observer, all in 1/s."""

    rate: float
    gain: float
    learning: float


def adapt(now: Estimates, h: Array, before: Array, reading: Array, active: Array, dt: float, rates: Rates) -> Estimates:
    """Return the estimates after a step of dt seconds, for x' = -rate x + h and y = x + f.

        x^' = -rate x^ + h + L (y - x^ - f^) + Omega f^'    Omega' = -(rate + L) Omega - L
        f^' = Gamma (Omega + 1) D (y - x^ - f^)

    before, reading: y before and after the step. active: D, bool. L and Gamma are those of `rates`. The linear part is exact
    for h and y held over the step; the adaptive law uses an Euler step. A NaN reading corrects nothing.
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
    """Return Gamma (1 + Omega)^2, 1/s, the decay rate of the fault's error at steady Omega = -L / (rate + L).

    The innovation is then (1 + Omega)(f - f^): with a gain far above the rate the observer follows the faulty reading.
    """
    rate, gain, learning = rates
    return learning * (rate / (rate + gain)) ** 2
