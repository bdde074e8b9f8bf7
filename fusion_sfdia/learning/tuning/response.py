"""How a plant responds at one point, as two numbers that a tuned file keeps: they tell when its equations have changed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, shown
from fusion_sfdia.common.warned import warn
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

SAME = 1e-8  # of the terms of a sum: far above rounding, far below what a changed parameter moves


class ModelChangedWarning(UserWarning):
    """The equations of a plant are not those for which a file was tuned."""


def response(plant: Plant) -> list[float]:
    """The next state and the readings one standard deviation beside the first state, where a balance at rest does not hide
    a parameter: each as a weighted sum over its standard deviations. [] where the plant cannot be evaluated there.
    """
    return [float(np.sum(terms)) for terms in _terms(plant)]


def warn_of_change(found: dict[str, Any], plant: Plant) -> None:
    """Warn where the response of a plant is not the one in the [plant] table of a tuned file, which older files lack."""
    kept = found.get("response", [])
    if not isinstance(kept, list):
        raise ValueError(f"response is {shown(kept)}; expected a list of numbers, as `fusion-sfdia tune` writes it")
    kept = [number("response", value) for value in kept]
    pairs = zip(kept, _terms(plant) if kept else [], strict=False)
    if any(not abs(value - np.sum(terms)) <= SAME * np.sum(np.abs(terms)) for value, terms in pairs):
        warn(
            f"the model of plant {plant.name!r} has changed since it was tuned: what was learnt and the thresholds may not "
            "hold; tune again",
            ModelChangedWarning,
        )


def _terms(plant: Plant) -> list[Array]:
    """The terms of both sums; weights that no symmetry of a plant makes cancel."""
    cov = np.asarray(plant.initial_cov)
    sd = np.sqrt(cov if cov.ndim == 1 else np.diagonal(cov))
    try:
        x, u = plant.guard((plant.x0 + sd)[None])[0], plant.input_at(0.0)[None]
        with np.errstate(all="ignore"):
            ahead = np.asarray(plant.step(0.0, x, u, plant.dt))[0] / np.where(sd > 0, sd, 1.0)
            readings = np.asarray(plant.output(plant.dt, x, u))[0] / plant.sensor_sigma
    except (ArithmeticError, ValueError):
        return []
    found = [values * np.cos(np.arange(values.size)) for values in (ahead, readings)]
    return found if all(np.isfinite(terms).all() for terms in found) else []
