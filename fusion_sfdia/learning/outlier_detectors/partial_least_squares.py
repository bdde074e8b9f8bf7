"""Detector: each sensor predicted from all others and the inputs by partial least squares.

    y_i = b_i + w_i' x_i + e_i,    x_i = (y_j for j != i, u),    w_i = R_i q_i    (Wold, Sjoestroem and Eriksson 2001)

R_i are the directions of x_i that covary most with y_i, one after the other, so that readings which move together do not have
weights that cancel. Their number is chosen for each sensor by cross-validation within the healthy runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from sklearn.cross_decomposition import PLSRegression
from sklearn.model_selection import KFold

from fusion_sfdia.common.arguments import floats, probability
from fusion_sfdia.detectors.batch_detector import BatchDetector, TimeStep
from fusion_sfdia.detectors.data_driven.ewma_limits import averaged
from fusion_sfdia.detectors.data_driven.healthy_limits import without_model
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

MOST, FOLDS = 10, 4  # components, and consecutive parts of the healthy runs that are left out in turn
LEAST = 20  # samples in each part
WEIGHT = 0.05  # of the moving average of errors: 20 samples
ROUNDS = 3  # in which missing readings are predicted from predictions


class AverageError(NamedTuple):
    """The moving average of each sensor's error (..., N), and the number of errors in it."""

    average: Array
    samples: Array


@dataclass(frozen=True, eq=False)
class PartialLeastSquares(BatchDetector):
    """Tests of the errors e of leave-one-out predictions, and of their exponentially weighted moving averages.

    weights (N, N + m): of all readings and inputs, about centre (N + m,); that of a sensor for itself is 0. error, average
    (N,): limits. components (N,): of each sensor. The sensor with the largest ratio to a limit is isolated and its reading
    replaced by its prediction, until no ratio exceeds 1 or half of the sensors are isolated. A sensor is tested where at least
    half of the other ones are read; missing readings are replaced by predictions. No state is estimated: estimate is the
    plant's x0.
    """

    weights: Array
    centre: Array
    error: Array
    average: Array
    components: tuple[int, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        n, m = len(self.plant.sensors), len(self.plant.inputs)
        for what, shape in (("weights", (n, n + m)), ("centre", (n + m,)), ("error", (n,)), ("average", (n,))):
            value = floats(what, getattr(self, what))
            if value.shape != shape:
                raise ValueError(f"{what} has shape {value.shape}; expected {shape}; use PartialLeastSquares.of_runs")
            object.__setattr__(self, what, value)

    @classmethod
    def of_runs(cls, plant: Plant, logs: Sequence[Log], false_alarm: float = 1e-3) -> Self:
        """Predictors and limits from healthy runs, t (K,), y (K, N), u (K, m), of which rows with all readings are used.

        The limits are those of normal errors with the mean squares of the errors left out in cross-validation, at a rate of
        false alarms per step over all sensors, in equal parts for both tests. ValueError for fewer than two sensors and
        inputs, and for too few rows.
        """
        probability("false_alarm", false_alarm)
        z = np.concatenate([np.concatenate([y, u], axis=1)[np.isfinite(y).all(axis=1)] for _, y, u in logs])
        n = len(plant.sensors)
        if z.shape[1] < 2 or len(z) < FOLDS * LEAST:
            raise ValueError(
                f"{len(z)} rows with all readings of {z.shape[1]} sensors and inputs for partial least squares; expected at "
                f"least {FOLDS * LEAST} of two; record more, or leave out the sensors that are often missing"
            )
        centre = np.mean(z, axis=0)
        z = z - centre
        weights, errors, components = np.zeros((n, z.shape[1])), np.empty((len(z), n)), []
        for i in range(n):
            x = np.delete(z, i, axis=1)
            left = _left_out(x, z[:, i])
            k = int(np.argmin(np.mean(left**2, axis=0)))
            errors[:, i] = left[:, k]
            components.append(k + 1)
            weights[i, np.arange(z.shape[1]) != i] = PLSRegression(k + 1).fit(x, z[:, i]).coef_[0]
        smooth, mean = np.empty_like(errors), AverageError(np.zeros(n), np.zeros(n))
        for row, now in enumerate(errors):
            mean = AverageError(*averaged(*mean, now, WEIGHT))
            smooth[row] = mean.average
        q = -float(ndtri(false_alarm / (4 * n)))
        least = np.finfo(float).eps * np.maximum(np.abs(centre[:n]), 1e-300)
        error, average = (np.maximum(q * np.sqrt(np.mean(e**2, axis=0)), least) for e in (errors, smooth))
        return cls(plant, weights, centre, error, average, tuple(components))

    @property
    def most_faults(self) -> int:
        """Half of the sensors, at least one."""
        return max(len(self.plant.sensors) // 2, 1)

    def _start(self, batch: tuple[int, ...], seed: int) -> AverageError:
        shape = (*batch, len(self.plant.sensors))
        return AverageError(np.zeros(shape), np.zeros(shape))

    def _judge(self, memory: AverageError, now: TimeStep, y: Array, u: Array) -> tuple[AverageError, Decision]:
        known, n = np.isfinite(y), y.shape[-1]
        tested = known & (2 * (np.sum(known, axis=-1, keepdims=True) - 1) >= n - 1)
        isolated, residual, threshold = np.zeros(y.shape, bool), np.full(y.shape, np.nan), np.full(y.shape, np.inf)
        limits = self.threshold_scale * self.error, self.threshold_scale * self.average
        for _ in range(self.most_faults + 1):
            expected = self._predicted(np.where(known & ~isolated, y, np.nan), u)
            error = np.where(tested, y - expected, np.nan)
            after = averaged(*memory, np.clip(error, -self.error, self.error), WEIGHT)
            slow = np.abs(after[0]) / limits[1] > np.abs(error) / limits[0]
            residual = np.where(isolated, residual, np.where(tested & slow, after[0], error))
            threshold = np.where(isolated, threshold, np.where(slow, *limits[::-1]))
            ratio = np.where(tested & ~isolated, np.abs(residual) / threshold, 0.0)
            worst = np.argmax(ratio, axis=-1)[..., None]
            beyond = (np.arange(n) == worst) & (ratio > 1)
            room = np.sum(isolated, axis=-1, keepdims=True) < self.most_faults
            if not np.any(beyond & room):
                break
            isolated = isolated | (beyond & room)
        reconstruction = np.where(known & ~isolated, y, expected)
        decision = without_model(self.plant, y, reconstruction, residual, threshold, isolated)
        return AverageError(*after), decision

    def _predicted(self, y: Array, u: Array) -> Array:
        """Each reading predicted from the others, y (..., N), NaN where unknown, and u (..., m)."""
        n = y.shape[-1]
        z, unknown = np.concatenate([y, u], axis=-1) - self.centre, np.isnan(y)
        z[..., :n] = np.nan_to_num(z[..., :n])
        for _ in range(ROUNDS if unknown.any() else 0):
            z[..., :n] = np.where(unknown, z @ self.weights.T, z[..., :n])
        return np.asarray(z @ self.weights.T + self.centre[:n])


def _left_out(x: Array, y: Array) -> Array:
    """Errors (K, k) of predictions of y (K,) from x (K, p) by 1 to k components, each part by what was learnt from the others.

    The scores of the first components do not depend on the number of those after them, so that one fit gives all.
    """
    most = min(MOST, x.shape[1])
    errors = np.empty((len(y), most))
    for learnt, left in KFold(FOLDS).split(x):
        fitted = PLSRegression(most).fit(x[learnt], y[learnt])
        parts = fitted.transform(x[left]) * fitted.y_loadings_[0] * np.std(y[learnt], ddof=1)
        errors[left] = y[left, None] - np.mean(y[learnt]) - np.cumsum(parts, axis=1)
    return errors
