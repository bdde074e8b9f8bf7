"""Detector: principal components of healthy readings, the multivariate statistical monitoring of process plants."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fusion_sfdia.core.arguments import floats, number, probability, shown, whole
from fusion_sfdia.core.batch_detector import BatchDetector, Moment
from fusion_sfdia.core.detector import Decision, NotApplicableError, State
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.data_driven.healthy_limits import healthy_readings, noise_floor, per_sensor, stuck, upper_limit, without_model

Array = NDArray[Any]


class Statistics(NamedTuple):
    """Of readings (B, N), standardised: t2, spe (B,); filled (B, N) in full; and, 0 where unknown, the error of each reading
    against its reconstruction from the other known ones, and its sensitivity: what the index gains by a unit of error.
    """

    t2: Array
    spe: Array
    filled: Array
    error: Array
    sensitivity: Array

    @property
    def contribution(self) -> Array:
        """The root of what the index loses when a reading is reconstructed (B, N)."""
        return np.asarray(np.abs(self.error) * np.sqrt(self.sensitivity))


@dataclass(frozen=True, eq=False)
class PrincipalComponents(BatchDetector):
    """T2 and SPE of standardised readings x, their limits and the model from healthy data (Jackson and Mudholkar 1979):

        t = P x    T2 = t' Lambda^-1 t    SPE = |x - P' t|^2

    centre, scale: (N,) in sensor units. components: P (k, N) with orthonormal rows, 0 < k < N. variances: Lambda (k,).
    noise: the mean variance of the components left out. limit_t2, limit_spe: an alarm is raised beyond either.

    Missing readings are the known-data regression (Arteaga and Ferrer 2002) under the covariance P' Lambda P + noise (I - P' P)
    of the retained components (Tipping and Bishop 1999), which minimises the combined index x' M x = T2 + SPE / noise, of which
    M is that covariance's inverse. A reading is reconstructed in the same way, as if it were missing. Its reconstruction-based
    contribution is what the index loses by that (Dunia and Qin 1998; Alcala and Qin 2009): (M x)_i^2 / M_ii.

    After an alarm the sensors of the largest contribution are reconstructed one by one, at most max_faults, until both
    statistics are within their limits: then these are named, and none where that does not come about. fault_size: reading
    less its reconstruction. measured: named and missing readings reconstructed. residual: each reading less its reconstruction
    from all others. threshold: so that the largest ratio is sqrt(max(T2 / limit_t2, SPE / limit_spe)) and the others are to
    it as the roots of the contributions are. No state is estimated: estimate is the plant's x0.

    Of an operation that moves, readings are divided by the movement, and what components leave of it widens the limit of SPE:
    with few of them a fault is hidden that is small against the movement, however large it is against the noise.
    """

    centre: Array
    scale: Array
    components: Array
    variances: Array
    noise: float
    limit_t2: float
    limit_spe: float
    max_faults: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        n = len(self.plant.sensors)
        for what in ("centre", "scale"):
            object.__setattr__(self, what, per_sensor(self.plant, what, getattr(self, what)))
        for what in ("components", "variances"):
            object.__setattr__(self, what, floats(what, getattr(self, what)))
        k = len(self.variances)
        if self.components.shape != (k, n) or not 0 < k < n:
            raise ValueError(
                f"components has shape {self.components.shape} for {self.variances.shape} variances and {n} sensors; wanted "
                "(k, sensors) and (k,), with fewer components than sensors"
            )
        if not np.allclose(self.components @ self.components.T, np.eye(k), atol=1e-9):
            raise ValueError("the rows of components are not orthonormal; take them from a principal component analysis")
        for what in ("noise", "limit_t2", "limit_spe"):
            object.__setattr__(self, what, number(what, getattr(self, what)))
        for what in ("scale", "variances", "noise", "limit_t2", "limit_spe"):
            if not np.all(np.asarray(value := getattr(self, what)) > 0):
                raise ValueError(f"{what} is {shown(value)}; wanted positive, as of PrincipalComponents.fit")
        if whole("max_faults", self.max_faults, least=1) > n:
            raise ValueError(f"max_faults is {self.max_faults}; plant {self.plant.name!r} has {n} sensors")

    @classmethod
    def fit(
        cls, plant: Plant, y: Array, false_alarm: float = 1e-3, components: int | float = 0.99, max_faults: int = 3
    ) -> PrincipalComponents:
        """Model and limits from healthy readings y (K, ..., N), at that rate of false alarms per step.

        Every other sample in time trains the model, standardised by mean and standard deviation; the rest set the limits as
        order statistics, T2 and SPE sharing the rate equally. Samples with a missing reading are left out. A sensor that never
        moved is standardised by the sigma that it declares, at least its resolution. components: how many
        are retained or, as a share, the fewest that explain it of the variance, one less than the sensors at most. ValueError
        where the data are too few for the rate or the sensors, or no sensor ever moved.
        """
        from sklearn.decomposition import PCA  # slow to import

        probability("false_alarm", false_alarm)
        y, n = healthy_readings(plant, y), len(plant.sensors)
        train, judge = (part[np.all(np.isfinite(part), axis=-1)] for part in (y[::2], y[1::2]))
        if n < 2:
            raise NotApplicableError(f"plant {plant.name!r} has {n} sensor; principal components take at least 2")
        if len(train) <= n:
            raise ValueError(f"{len(train)} complete samples of {n} sensors to train on; wanted more samples than sensors")
        still = stuck(train[:, None])
        if still.all():
            raise ValueError("no sensor ever moved in the healthy readings; record them with their noise")
        centre = np.where(still, train[0], train.mean(axis=0))
        scale = np.where(still, noise_floor(plant, y, plant.sensor_sigma), train.std(axis=0))
        found = PCA(svd_solver="full").fit((train - centre) / scale)
        if isinstance(components, float):
            share = probability("components", components)
            components = min(int(np.sum(np.cumsum(found.explained_variance_ratio_) < share)) + 1, n - 1)
        if (k := whole("components", components, least=1)) >= n:
            raise ValueError(f"components is {k}; wanted fewer than the {n} sensors of plant {plant.name!r}")
        retained, left = np.split(found.explained_variance_, [k])
        rounding = n * np.finfo(float).eps
        noise = float(left.mean())
        noise = noise if noise > rounding else 1.0  # what is left never moved: the noise that it declares
        model = cls(plant, centre, scale, found.components_[:k], retained, noise, np.inf, np.inf, max_faults)
        s = model.statistics(judge)
        t2, spe = (upper_limit(value, false_alarm / 2) for value in (s.t2, s.spe))
        if not spe > rounding:  # of Gaussian readings with that noise
            spe = noise * float(chdtri(n - k, false_alarm / 2))
        return replace(model, limit_t2=t2, limit_spe=spe)

    @cached_property
    def precision(self) -> Array:
        """M (N, N): P' Lambda^-1 P + (I - P' P) / noise."""
        p = self.components
        return np.asarray((p.T / self.variances) @ p + (np.eye(p.shape[1]) - p.T @ p) / self.noise)

    def statistics(self, y: Array) -> Statistics:
        """The statistics of readings y (B, N), NaN where missing."""
        known = np.isfinite(y)
        z = np.where(known, (y - self.centre) / self.scale, 0.0)
        x, gradient, sensitivity = z.copy(), np.empty_like(z), np.empty_like(z)
        # one pattern where nothing is missing, the usual case
        patterns, which = (known[:1], np.zeros(len(y))) if known.all() else np.unique(known, axis=0, return_inverse=True)
        for i, pattern in enumerate(patterns):
            rows = which.ravel() == i
            fill = self._regression(pattern)
            marginal = fill.T @ self.precision @ fill  # the inverse covariance of what is known
            x[rows] = z[rows] @ fill.T
            gradient[rows] = z[rows] @ marginal
            sensitivity[rows] = np.diagonal(marginal)
        scores = x @ self.components.T
        error = np.divide(gradient, sensitivity, out=np.zeros_like(z), where=known)
        return Statistics(
            t2=np.sum(scores**2 / self.variances, axis=-1),
            spe=np.sum((x - scores @ self.components) ** 2, axis=-1),
            filled=self.centre + self.scale * x,
            error=error,
            sensitivity=np.where(known, sensitivity, 0.0),
        )

    def _regression(self, known: Array) -> Array:
        """The map (N, N) from known readings, 0 elsewhere, to all: x_m = -M_mm^-1 M_mo x_o."""
        fill = np.diag(known.astype(float))
        if not known.all():
            m = self.precision[~known]
            fill[np.ix_(~known, known)] = -np.linalg.solve(m[:, ~known], m[:, known])
        return fill

    def _excess(self, s: Statistics) -> Array:
        """The larger root of a statistic over its limit (B,); an alarm is above 1."""
        return np.sqrt(np.maximum(s.t2 / self.limit_t2, s.spe / self.limit_spe)) / self.threshold_scale

    def _start(self, batch: tuple[int, ...], seed: int) -> State:
        return ()

    def _judge(self, core: State, now: Moment, y: Array, u: Array) -> tuple[State, Decision]:
        flat = y.reshape(-1, y.shape[-1])
        s = self.statistics(flat)
        excess, contribution = self._excess(s), s.contribution
        weight = np.max(contribution, axis=-1, keepdims=True) / excess[:, None]
        threshold = self.scale * weight / np.sqrt(s.sensitivity)
        isolated = self._isolate(flat, excess > 1, contribution)
        trusted = np.isfinite(flat) & ~isolated
        measured = np.where(trusted, flat, self.statistics(np.where(trusted, flat, np.nan)).filled)
        residual = np.where(np.isfinite(flat), s.error * self.scale, np.nan)
        threshold = np.where(threshold > 0, threshold, np.inf)  # 0 / 0 without a reading
        told = (a.reshape(y.shape) for a in (flat, measured, residual, threshold, isolated))
        return (), without_model(self.plant, *told)

    def _isolate(self, y: Array, alarm: Array, contribution: Array) -> Array:
        """The sensors (B, N) whose reconstruction brings both statistics within their limits."""
        isolated = np.zeros(y.shape, bool)
        rows = np.flatnonzero(alarm)
        suspects = np.zeros((len(rows), y.shape[-1]), bool)
        contribution = contribution[rows]
        for _ in range(self.max_faults):
            if not rows.size:
                break
            suspects[np.arange(len(rows)), np.argmax(contribution, axis=-1)] = True
            s = self.statistics(np.where(suspects, np.nan, y[rows]))
            explained = self._excess(s) <= 1
            isolated[rows[explained]] = suspects[explained]
            rows, suspects = rows[~explained], suspects[~explained]
            contribution = s.contribution[~explained]
        return isolated
