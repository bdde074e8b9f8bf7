"""Single readings in a healthy log that contradict all others, and whether a wrong convention of inputs explains them.

An input taken for a row too late or too early is wrong in one row at each of its steps. Of n rows with a spike, h beside one of
the largest steps of an input, which are a share p of all rows, are chance with the probability P(Binomial(n, p) >= h).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

SPIKE = 10.0  # standard deviations
STEPS = 0.05  # of the changes of an input are its steps at most
CHANCE = 1e-4  # probability that spikes elsewhere are taken for spikes at steps of inputs


def require_no_spike(plant: Plant, residual: Array, u: Array, at: Callable[[int, int], str]) -> None:
    """Raise ValueError where residuals (K, B, N), in standard deviations of the model, have a spike; u (K, B, m): inputs that
    acted until each sample.

    A sensor's spread is that of the middle half of its residuals; of one that reads in steps, most of whose readings may be
    equal, at least that of the model. at: the time of a sample of a run in words.
    """
    middle = np.nanmedian(residual, axis=(0, 1))
    spread = 1.4826 * np.nanmedian(np.abs(residual - middle), axis=(0, 1))
    spread = np.maximum(spread, np.where(plant.sensor_resolution > 0, 1.0, np.finfo(float).tiny))
    size = np.nan_to_num(np.abs(residual - middle) / spread)
    k, b, i = (int(j) for j in np.unravel_index(int(np.argmax(size)), size.shape))
    if not size[k, b, i] > SPIKE:
        return
    more = int(np.sum(size > SPIKE)) - 1
    also = f", as do{'es' * (more == 1)} {more} more reading{'s' * (more != 1)}" if more else ""
    cure = of_convention(plant, np.any(size > SPIKE, axis=-1), u) or "leave spikes out (NaN), or give a log without faults"
    raise ValueError(
        f"sensor {plant.sensors[i].name!r} contradicts all others at {at(k, b)}, by {size[k, b, i]:.3g} of its standard "
        f"deviations{also}; {cure}"
    )


def of_convention(plant: Plant, spikes: Array, u: Array) -> str:
    """The cure where spikes (K, B) are beside the steps of an input (K, B, m), "" where they are not."""
    count, found = int(np.sum(spikes)), []
    for signal, values in zip(plant.inputs, np.moveaxis(u, -1, 0), strict=True):
        change = np.abs(np.diff(values, axis=0))
        steps = (change > 0) & (change >= np.quantile(change, 1 - STEPS))
        share = np.mean(steps)
        for rows, where, convention in (
            (spikes[:-1], "in the row before", "until the sample"),
            (spikes[1:], "in the row of", "at the sample"),
        ):
            hits = int(np.sum(rows & steps))
            if hits and binom.sf(hits - 1, count, share) < CHANCE:
                found.append((hits, signal.name, where, convention))
    if not found:
        return ""
    hits, name, where, convention = max(found)
    return (
        f"{hits} of {count} rows with such a reading are {where} a step of input {name!r}, so that it seems to be read a row "
        f'too {"late" if convention == "until the sample" else "early"}: state inputs = "{convention}" in the map of the log'
    )
