"""Numbers that cannot be readings or inputs: taken as missing, or replaced, before any detector uses them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]
EPS = float(np.finfo(float).eps)


def terms(plant: Plant) -> int:
    """N + n: of how many terms the sums of an update are."""
    return len(plant.sensors) + len(plant.states)


def largest_readings(plant: Plant) -> Array:
    """The largest magnitude of a reading of each sensor (N,), in its unit: sigma / ((N + n) eps).

    An update takes sums over N readings and n states; one of size |y| rounds them by up to (N + n) eps |y|. Where that exceeds
    the noise sigma it spoils what all other sensors say. No instrument comes near: its noise would be less than the last digits
    of what it reads.
    """
    return plant.sensor_sigma / (terms(plant) * EPS)


def possible(plant: Plant, y: Array) -> Array:
    """Return the readings y (..., N) with NaN in place of the absurd ones, those beyond `largest_readings`."""
    absurd = np.abs(y) > largest_readings(plant)  # not so where NaN
    return np.where(absurd, np.nan, y) if absurd.any() else y


class InputLimits:
    """What the inputs of a plant can be.

    An input is suspect outside the limits of its signal, beyond which the model is not said to hold, and where none are
    declared, beyond 1 / ((N + n) eps) times its nominal value or, if that is 0, its unit. A suspect one is absurd where, with
    the usual values of the other inputs, a step takes the model from x0 out of the limits of its states, or to no number, or
    to where a state or reading cannot resolve its own scale (see `largest_readings`). An input must be known to go on: the
    plant's usual one at that time stands for an absurd one.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        signals = plant.inputs
        far = np.array([abs(s.nominal) or 1.0 for s in signals]) / (terms(plant) * EPS)
        low, high = np.array([s.low for s in signals]), np.array([s.high for s in signals])
        self.low, self.high = np.where(np.isinf(low), -far, low), np.where(np.isinf(high), far, high)

    def applied(self, t_start: float, dt: float, u: Array) -> Array:
        """Return the inputs u (..., m) over [t_start, t_start + dt] with the usual ones in place of the absurd ones."""
        suspect = (u < self.low) | (u > self.high)
        if not suspect.any():
            return u
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
        resolved = np.abs(x) <= plant.state_scale / (terms(plant) * EPS), np.abs(y) <= largest_readings(plant)
        return bool(left) or not all(np.all(each) for each in resolved)
