"""How well a plant predicts readings that it was not identified from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

WARM_UP = 10  # samples after the start of a run that are not judged
LONGEST = 1000  # samples that are stepped as one run


class LeftOut(NamedTuple):
    """Sums over the judged readings: log-likelihood in units of `scale`, normalised innovation squared, their number."""

    log_likelihood: float
    chi_square: float
    readings: int

    def plus(self, other: LeftOut) -> LeftOut:
        return LeftOut(
            self.log_likelihood + other.log_likelihood, self.chi_square + other.chi_square, self.readings + other.readings
        )


def side_by_side(logs: Sequence[Log]) -> tuple[Array, Array, Array]:
    """Return runs as a batch: y (K, B, N), u (K, B, m), and which samples are of a run (K, B), the rest being missing.

    A run of more than LONGEST samples is stepped as several.
    """
    parts = [Log(*(part[a : a + LONGEST] for part in log)) for log in logs for a in range(0, len(log.t), LONGEST)]
    shape = max(len(part.t) for part in parts), len(parts)
    y, u = np.full((*shape, parts[0].y.shape[1]), np.nan), np.zeros((*shape, parts[0].u.shape[1]))
    for b, (t, readings, applied) in enumerate(parts):
        y[: len(t), b], u[: len(t), b], u[len(t) :, b] = readings, applied, applied[-1]
    return y, u, np.arange(shape[0])[:, None] < [len(part.t) for part in parts]


def left_out(plant: Plant, logs: Sequence[Log], scale: Array) -> LeftOut:
    """The one-step predictions by the extended Kalman filter of runs without gaps, -(e' S^-1 e + log |2 pi S|) / 2.

    scale (N,): the unit of each reading. Runs are stepped `side_by_side`; the first WARM_UP samples of each, or the
    first quarter of a shorter one, are not judged.
    """
    y, u, own = side_by_side(logs)
    judged = np.arange(len(own))[:, None] >= np.minimum(WARM_UP, own.sum(axis=0) // 4)
    steps, size, _ = y.shape
    estimator, rng = Extended(), np.random.default_rng(0)  # this filter draws nothing
    core = estimator.start(plant, (size,), rng)
    total = LeftOut(0.0, 0.0, 0)
    for k in range(steps):
        prior = estimator.predict(plant, core, k * plant.dt, u[k], plant.dt, rng)
        joint = estimator.joint(plant, prior, (k + 1) * plant.dt, u[k])
        found = condition(joint, y[k])
        core = core._replace(x=found.x, P=found.P)
        used = found.used & judged[k, :, None]
        if count := int(used.sum()):
            S = np.where(used[..., :, None] & used[..., None, :], joint.S / np.outer(scale, scale), np.eye(len(scale)))
            chi_square = float(np.sum(np.where(used.any(axis=-1), found.nis * used.sum(axis=-1), 0.0)))
            log_det = float(np.sum(np.linalg.slogdet(S)[1])) + count * np.log(2 * np.pi)
            total = total.plus(LeftOut(-(chi_square + log_det) / 2, chi_square, count))
    return total
