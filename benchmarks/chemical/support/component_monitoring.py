"""Monitoring of all 52 channels by principal components, as published for the recordings of the chemical plant."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.report.results import Published

Array = NDArray[Any]

COMPONENTS = 11
QUANTILE = 0.99  # of the healthy test recording
SOURCE = (
    "text of the recordings' fixture: PCA of d00, 11 components, limits at the 99 % quantile of d00_te, misses after sample 160"
)
MISSES = {"d01": (0.008, 0.002), "d04": (0.942, 0.034), "d05": (0.771, 0.742), "d11": (0.770, 0.346)}  # T2, Q
PUBLISHED = {
    (fault, statistic): Published(value, SOURCE)
    for fault, values in MISSES.items()
    for statistic, value in zip(("T2", "Q"), values, strict=True)
}


class Monitoring(NamedTuple):
    """mean, sd (D,) of the training data; retained directions P (D, k) and their variances (k,)."""

    mean: Array
    sd: Array
    P: Array
    variances: Array

    def statistics(self, y: Array) -> dict[str, Array]:
        """T2 = t' Lambda^-1 t and Q = |x - P t|^2 of y (K, D), (K,) each, with t = P' x (Jackson and Mudholkar 1979)."""
        x = (y - self.mean) / self.sd
        t = x @ self.P
        return {"T2": np.sum(t**2 / self.variances, axis=1), "Q": np.sum((x - t @ self.P.T) ** 2, axis=1)}


def monitoring(healthy: Array, components: int = COMPONENTS) -> Monitoring:
    """The components of healthy channels (K, D) over their standard deviation."""
    mean, sd = healthy.mean(axis=0), healthy.std(axis=0, ddof=1)
    variances, vectors = np.linalg.eigh(np.cov(((healthy - mean) / sd).T))
    keep = np.argsort(variances)[::-1][:components]
    return Monitoring(mean, sd, vectors[:, keep], variances[keep])


def missed(training: Array, healthy: Array, faulty: Array) -> dict[str, float]:
    """The share of faulty samples (K, D) within the limits, by statistic; the limits are quantiles of `healthy`."""
    model = monitoring(training)
    limits = {name: np.quantile(values, QUANTILE) for name, values in model.statistics(healthy).items()}
    return {name: float(np.mean(values <= limits[name])) for name, values in model.statistics(faulty).items()}
