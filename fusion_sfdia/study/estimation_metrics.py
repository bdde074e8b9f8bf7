"""Accuracy of estimates: states, reconstructed readings, covariances, sizes of faults. Time first, then runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fusion_sfdia.common.run_statistics import LEVEL, NOTHING, Estimate, mean_over_runs, require_shapes
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


def rmse(estimate: Array, truth: Array, where: Array | None = None) -> Estimate:
    """Mean over runs of ||X - X_hat||_F / sqrt(number of entries), with an interval over runs (Shaheen 2024, sec. V-A).

    estimate, truth (K, B, n): give the columns of one quantity (measured_states), as units differ. where (K, B).
    The paper divides by N_s = L / ds = 20 though there are 21 nodes, which is 2.5 % more; here the entries are counted.
    Accommodation: the error of Decision.reconstruction against that of the readings as received (rmse_unaccommodated) and of
    the healthy ones (rmse_healthy), each against the noise-free signal. Entries that are NaN (a missing reading, a
    diverged estimate) are left out.
    """
    require_shapes(estimate=(estimate, truth.shape))
    return root_mean_square((estimate - truth) ** 2, where)


def root_mean_square(square: Array, where: Array | None = None) -> Estimate:
    """Mean over runs of the root of a run's mean of squared errors (K, B, n); the rest as in `rmse`."""
    counted = np.isfinite(square)
    counted = counted if where is None else counted & where[..., None]
    entries = counted.sum(axis=(0, 2))
    some = entries > 0
    if not some.any():
        return NOTHING
    each = np.sqrt(np.where(counted, square, 0.0).sum(axis=(0, 2))[some] / entries[some])
    return mean_over_runs(each, np.ones(each.size))


def measured_states(plant: Plant) -> dict[str, Array]:
    """Return, by quantity, the indices of the states that its sensors read; quantities that read none are left out."""
    names = [s.name for s in plant.states]
    found = {
        quantity: np.unique([names.index(plant.sensors[i].measures) for i in members if plant.sensors[i].measures in names])
        for quantity, members in plant.quantities.items()
    }
    return {quantity: states.astype(int) for quantity, states in found.items() if states.size}


def nees(estimate: Array, truth: Array, covariance: Array) -> Estimate:
    """Mean of e' P^-1 e / n, e = x - x_hat: normalised estimation error squared per dimension, 1 for a consistent filter.

    estimate, truth (K, B, n), covariance (K, B, n, n). Samples that are not finite are left out. ValueError for a
    covariance that is singular or has a variance of 0.
    """
    n = truth.shape[-1]
    require_shapes(estimate=(estimate, truth.shape), covariance=(covariance, (*truth.shape, n)))
    error = estimate - truth
    counted = np.isfinite(error).all(axis=-1) & np.isfinite(covariance).all(axis=(-2, -1))
    e, P = error[counted], covariance[counted]
    variance = np.diagonal(P, axis1=-2, axis2=-1)
    if np.any(variance <= 0):
        raise ValueError("a covariance has a variance that is not positive; NEES expects positive definite ones")
    scale = np.sqrt(variance)
    e, P = e / scale, P / (scale[:, :, None] * scale[:, None, :])
    try:
        squares = (e * np.linalg.solve(P, e[..., None])[..., 0]).sum(axis=-1) / n
    except np.linalg.LinAlgError as error_found:
        raise ValueError("a covariance is singular; NEES expects positive definite ones") from error_found
    values = np.zeros(counted.shape)
    values[counted] = squares
    return mean_over_runs(values.sum(axis=0), counted.sum(axis=0))


def nis(values: Array) -> Estimate:
    """Mean of Decision.nis (K, B), the normalised innovation squared per reading; NaN (nothing read) is left out."""
    counted = np.isfinite(values)
    return mean_over_runs(np.where(counted, values, 0.0).sum(axis=0), counted.sum(axis=0))


def consistency_limits(dimension: int, runs: int) -> tuple[float, float]:
    """Limits between which the mean NEES (or NIS) per dimension of a consistent filter is with probability 0.95, at one time.

    runs x dimension x mean is chi-square with runs x dimension degrees of freedom (Bar-Shalom, Li and Kirubarajan 2001,
    sec. 5.4). Over time NEES is correlated, and the limits hold for one time only.
    """
    if dimension < 1 or runs < 1:
        raise ValueError(f"dimension is {dimension} and runs is {runs}; both must be at least 1")
    degrees = dimension * runs
    low, high = stats.chi2.ppf([(1 - LEVEL) / 2, (1 + LEVEL) / 2], degrees) / degrees
    return float(low), float(high)


def fault_mape_percent(fault_size: Array, size: Array, isolated: Array, active: Array) -> Estimate:
    """Mean of 100 |size_hat / size - 1| over the faulty sensor-samples that are isolated, with an interval over runs.

    All (K, B, N). Where a size is NaN (dropout, no estimate) or the true size is 0, the sample is left out: a fault that
    is not isolated has no size, so read it together with isolation_recall.
    """
    require_shapes(fault_size=(fault_size, size.shape), isolated=(isolated, size.shape), active=(active, size.shape))
    counted = isolated & active & np.isfinite(fault_size) & np.isfinite(size) & (size != 0)
    ratio = np.where(counted, fault_size, 1.0) / np.where(counted, size, 1.0)
    return mean_over_runs(100 * np.abs(ratio - 1).sum(axis=(0, 2)), counted.sum(axis=(0, 2)))
