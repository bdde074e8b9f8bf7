"""Readings and inputs of impossible magnitude: taken as missing, or replaced, before any detector uses them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
EPS = float(np.finfo(float).eps)


def terms(plant: Plant) -> int:
    """N + n, the number of terms in the sums of an update."""
    return len(plant.sensors) + len(plant.states)


def possible(plant: Plant, y: Array) -> Array:
    """Return the readings y (..., N) with NaN for the absurd ones, whose magnitude exceeds the plant's `largest_readings`."""
    absurd = np.abs(y) > plant.largest_readings  # False where NaN
    return np.where(absurd, np.nan, y) if absurd.any() else y


class InputLimits:
    """The range of the inputs of a plant.

    An input is suspect outside the limits of its signal, where the model is not stated to hold. Without stated limits it is
    suspect beyond 1 / ((N + n) eps) times its nominal value or, if that is 0, its unit. A suspect input is absurd if, with the
    usual values of the other inputs, a step takes the model from x0 out of the limits of its states, to a value that is not
    finite, or to a state or reading that cannot resolve its own scale (see `Plant.largest_readings`). A step needs an input, so
    the plant's usual input at that time replaces an absurd one.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        signals = plant.inputs
        far = np.array([abs(s.nominal) or 1.0 for s in signals]) / (terms(plant) * EPS)
        low, high = np.array([s.low for s in signals]), np.array([s.high for s in signals])
        self.low, self.high = np.where(np.isinf(low), -far, low), np.where(np.isinf(high), far, high)

    def applied(self, t_start: float, dt: float, u: Array) -> Array:
        """Return the inputs u (..., m) over [t_start, t_start + dt] with the usual inputs in place of the absurd ones."""
        if ((u >= self.low) & (u <= self.high)).all():
            return u
        suspect = (u < self.low) | (u > self.high)
        usual, found = self.plant.input_at(t_start), u.copy()
        for where in np.argwhere(suspect):
            if self._absurd(t_start, dt, np.where(np.arange(u.shape[-1]) == where[-1], u[tuple(where[:-1])], usual)):
                found[tuple(where)] = usual[where[-1]]
        return found

    def _absurd(self, t_start: float, dt: float, u: Array) -> bool:
        plant = self.plant
        try:
            with np.errstate(all="ignore"):
                x = np.asarray(plant.step(t_start, plant.x0, u, dt))
                y = np.asarray(plant.output(t_start + dt, x, u))
                _, left = plant.guard(x)
        except ArithmeticError:  # the model has no solution there
            return True
        resolved = np.abs(x) <= plant.state_scale / (terms(plant) * EPS), np.abs(y) <= plant.largest_readings
        return bool(left) or not all(np.all(each) for each in resolved)
