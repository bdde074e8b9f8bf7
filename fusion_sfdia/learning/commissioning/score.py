"""How well a plant predicts healthy readings: likelihood, normalised innovations, whiteness."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.innovations import filtered
from fusion_sfdia.plant.augment import fixed
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

LAGS = 20


class FilterScore(NamedTuple):
    """Of each sample (K, B): log_likelihood, nis (normalised innovation squared per reading), normal (K, B, N) innovations.

    single (K, B, N): errors of each reading predicted from all others, over their standard deviations.
    """

    log_likelihood: Array
    nis: Array
    normal: Array
    single: Array


def fitted(plant: Plant, log: Log) -> FilterScore:
    """Run the filter of a plant and its disturbances over a log of runs."""
    likelihood, nis, normal, single = [], [], [], []
    for now in filtered(fixed(plant), log):
        likelihood.append(now.log_likelihood)
        nis.append(np.sum(now.normal**2, axis=-1) / np.maximum(np.sum(now.used, axis=-1), 1))
        normal.append(np.where(now.used, now.normal, np.nan))
        single.append(now.single)
    return FilterScore(np.stack(likelihood), np.stack(nis), np.stack(normal), np.stack(single))


def coloured(normal: Array) -> float:
    """Return the share of autocorrelations of innovations (K, B, N), lags 1 to 20, outside their 95 % bands: .05 if white."""
    count, outside, total = len(normal), 0, 0
    filled = np.nan_to_num(normal)
    power = np.mean(filled**2, axis=0)
    for lag in range(1, min(LAGS, count // 4) + 1):
        r = np.sum(filled[lag:] * filled[:-lag], axis=0) / (count * np.where(power > 0, power, 1.0))
        outside += int(np.sum(np.abs(r) > 1.96 / np.sqrt(count)))
        total += int(np.sum(power > 0))
    return outside / max(total, 1)
