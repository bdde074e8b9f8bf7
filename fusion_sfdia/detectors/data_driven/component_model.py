"""Principal components of healthy readings in units of their noise: reconstruction of missing and suspect readings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, number, shown, whole
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors.data_driven.healthy_limits import healthy_readings, per_sensor
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

PATTERNS = 64  # of missing readings, for which what follows from them is kept


class Reconstruction(NamedTuple):
    """Results of windows of readings (B, N, L + 1).

    x (B, D): standardised, missing readings filled in. Of each sensor (B, N), 0 where its present reading is missing: the error
    of that reading against its reconstruction from the other sensors, and its contribution, the root of the decrease of the
    index x' M x by that reconstruction.
    """

    x: Array
    error: Array
    contribution: Array


def marchenko_pastur_edge(variables: int, samples: int) -> float:
    """The largest eigenvalue, in the limit of many, of the covariance of so many samples of white noise of variance 1:

    (1 + sqrt(variables / samples))^2    (Marchenko and Pastur 1967)

    Windows that overlap have the same edge where they are short against the number of sensors (Loubaton 2016).
    """
    return float((1 + np.sqrt(variables / samples)) ** 2)


@dataclass(frozen=True, eq=False)
class ComponentModel:
    """The covariance of standardised windows x of readings, of retained components and white noise (Tipping and Bishop 1999):

        S = P' Lambda P + noise (I - P' P)    M = S^-1

    A window is the present reading and the `lags` before it, of each sensor: D = N (L + 1) numbers, those of one sensor side by
    side with the present one first; lags = 0 for static components (Ku, Storer and Georgakis 1995 for others). Readings that
    are missing are the conditional mean x_m = -M_mm^-1 M_mo x_o (Arteaga and Ferrer 2002), which minimises the index x' M x.
    A sensor is reconstructed in the same way, as if its whole window were missing. Its reconstruction-based contribution is
    what the index loses by that (Dunia and Qin 1998; Alcala and Qin 2009): (M x)_i' (M_ii)^-1 (M x)_i.

    centre, scale: (N,) in sensor units. components: P (k, D) with orthonormal rows, 0 <= k < D. variances: Lambda (k,).
    noise: the mean variance of the components left out.
    """

    plant: Plant
    centre: Array
    scale: Array
    components: Array
    variances: Array
    noise: float
    lags: int = 0

    def __post_init__(self) -> None:
        for what in ("centre", "scale"):
            object.__setattr__(self, what, per_sensor(self.plant, what, getattr(self, what)))
        for what in ("components", "variances"):  # in one order: products of a copy have the same bits
            object.__setattr__(self, what, np.ascontiguousarray(floats(what, getattr(self, what))))
        k, d = self.variances.size, len(self.plant.sensors) * (whole("lags", self.lags, least=0) + 1)
        if self.components.shape != (k, d) or self.variances.ndim != 1 or k >= d:
            raise ValueError(
                f"components has shape {self.components.shape} for {self.variances.shape} variances; expected (k, {d}) and "
                f"(k,), with fewer components than the {d} readings of a window"
            )
        if not np.allclose(self.components @ self.components.T, np.eye(k), atol=1e-9):
            raise ValueError("the rows of components are not orthonormal; take them from a principal component analysis")
        object.__setattr__(self, "noise", number("noise", self.noise))
        for what in ("scale", "variances", "noise"):
            if not np.all(np.asarray(value := getattr(self, what)) > 0):
                raise ValueError(f"{what} is {shown(value)}; expected positive numbers; use ComponentModel.fit")

    @classmethod
    def fit(
        cls, plant: Plant, healthy: Any, lags: int = 0, components: int | None = None
    ) -> tuple[ComponentModel, Array, Array]:
        """The model of healthy readings (see `healthy_readings`), its windows (M, N, L + 1), and others for limits.

        Readings are divided by the stated noise of their sensors. Windows are of blocks of 5 lags + 1 samples that alternate
        in time, so that no reading is in both; those with a missing reading are left out. components: how many are retained;
        None for those whose variance exceeds `marchenko_pastur_edge`, the largest of noise alone; D - 1 at most.
        ValueError where there are too few windows; NotApplicableError for a plant of one sensor.
        """
        from sklearn.decomposition import PCA  # slow to import

        y, n = healthy_readings(plant, healthy), len(plant.sensors)
        if n < 2:
            raise NotApplicableError(f"plant {plant.name!r} has {n} sensor; principal components take at least 2")
        width = n * (whole("lags", lags, least=0) + 1)
        train, judge = (complete_windows(y, lags, half) for half in (0, 1))
        if len(train) <= width:
            raise ValueError(
                f"{len(train)} complete samples of {width} readings to train on; expected more samples than readings"
            )
        centre, scale = train[..., 0].mean(axis=0), plant.sensor_sigma
        with np.errstate(invalid="ignore"):  # shares of the variance, where there is none
            found = PCA(svd_solver="full").fit(((train - centre[:, None]) / scale[:, None]).reshape(-1, width))
        if components is None:
            edge = marchenko_pastur_edge(width, len(train))
            components = min(int(np.sum(found.explained_variance_ > edge)), width - 1)
        if (k := whole("components", components, least=0)) >= width:
            raise ValueError(f"components is {k}; expected fewer than the {width} readings of a window of plant {plant.name!r}")
        retained, left = np.split(found.explained_variance_, [k])
        if not left.mean() > 0:
            raise ValueError(
                f"the healthy readings of plant {plant.name!r} vary in {k} components only, so that their noise is unknown; "
                "record more, choose fewer components, or use limits, which accept sensors that never move"
            )
        return cls(plant, centre, scale, found.components_[:k], retained, float(left.mean()), lags), train, judge

    @cached_property
    def precision(self) -> Array:
        """M (D, D): P' Lambda^-1 P + (I - P' P) / noise."""
        p = self.components
        return np.asarray((p.T / self.variances) @ p + (np.eye(p.shape[1]) - p.T @ p) / self.noise)

    @cached_property
    def _blocks(self) -> Array:
        """M_ii of each sensor (N, L + 1, L + 1)."""
        n, w = len(self.centre), self.lags + 1
        each = np.arange(n)
        return np.asarray(self.precision.reshape(n, w, n, w)[each, :, each, :])

    def reconstruct(self, window: Array) -> Reconstruction:
        """The readings of windows (B, N, L + 1), NaN where missing, against each other."""
        n, w = window.shape[1:]
        known = np.isfinite(window)
        x = np.where(known, (window - self.centre[:, None]) / self.scale[:, None], 0.0).reshape(len(window), n * w)
        gradient, error, contribution = np.empty_like(x), np.empty((len(x), n)), np.empty((len(x), n))
        flat = known.reshape(x.shape)
        # one pattern where nothing is missing, the usual case
        patterns, which = (flat[:1], np.zeros(len(x))) if known.all() else np.unique(flat, axis=0, return_inverse=True)
        for i, pattern in enumerate(patterns):
            rows, (missing, covariances) = which.ravel() == i, self._given(pattern)
            x[np.ix_(rows, ~pattern)] = -x[rows] @ missing.T
            gradient[rows] = x[rows] @ self.precision
            g = np.where(pattern.reshape(n, w), gradient[rows].reshape(-1, n, w), 0.0)
            misfit = np.einsum("iab,kib->kia", covariances, g)
            error[rows] = misfit[..., 0]
            contribution[rows] = np.sqrt(np.maximum(np.sum(g * misfit, axis=-1), 0.0))
        now = known[..., 0]
        return Reconstruction(x, np.where(now, error, 0.0), np.where(now, contribution, 0.0))

    def _given(self, pattern: Array) -> tuple[Array, Array]:
        """For a pattern of what is known (D,): M_mm^-1 M_m. of what is missing (m, D), and of each sensor the inverse of its
        block of the inverse covariance of what is known (N, L + 1, L + 1). Up to PATTERNS of them are kept.
        """
        if (found := self._patterns.get(key := pattern.tobytes())) is None:
            n, w = len(self.centre), self.lags + 1
            m = self.precision[~pattern]
            missing = np.linalg.solve(m[:, ~pattern], m)
            blocks = self._blocks - np.einsum("mia,mib->iab", m.reshape(-1, n, w), missing.reshape(-1, n, w))
            of_sensor = pattern.reshape(n, w)
            blocks = np.where(of_sensor[:, :, None] & of_sensor[:, None, :], blocks, np.eye(w))
            if len(self._patterns) >= PATTERNS:
                self._patterns.clear()
            found = self._patterns[key] = missing, np.linalg.inv(blocks)
        return found

    @cached_property
    def _patterns(self) -> dict[bytes, tuple[Array, Array]]:
        return {}

    def present(self, x: Array) -> Array:
        """The present readings (B, N) in sensor units of standardised windows x (B, D)."""
        return np.asarray(self.centre + self.scale * x[:, :: self.lags + 1])


def complete_windows(y: Array, lags: int, half: int) -> Array:
    """Windows (M, N, L + 1), present reading first, without a missing reading, of every other block of y (K, B, N) in time."""
    length = 5 * lags + 1
    blocks = y[: len(y) // length * length].reshape(-1, length, *y.shape[1:])[half::2]
    windows = np.lib.stride_tricks.sliding_window_view(blocks, lags + 1, axis=1)[..., ::-1]
    windows = windows.reshape(-1, y.shape[-1], lags + 1)
    return np.asarray(windows[np.all(np.isfinite(windows), axis=(1, 2))])
