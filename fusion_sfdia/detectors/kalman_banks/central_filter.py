"""Detector: one Kalman filter on all sensors with a test of each innovation; the common choice, used as the reference."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.common.arguments import probability
from fusion_sfdia.detectors.batch_detector import BatchDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.health import broken
from fusion_sfdia.detectors.kalman_banks.leave_one_out import normalised_innovation_squared, posterior, statistics
from fusion_sfdia.filters.estimators import Core, Estimator, Extended, Reading, drawn_by, require_filter, step_stream
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


@dataclass(frozen=True)
class CentralFilter(BatchDetector):
    """A single filter of any kind, without accommodation.

    Residual: y - E[y]. Threshold: from its variance, at the probability `false_alarm` per step over all sensors (Bonferroni).
    The sensor with the largest ratio above 1 is isolated.

    Parameters
    ----------
    estimator : Estimator, default Extended()
        The kind of filter: `Extended`, `Unscented`, `Ensemble` or `GaussianParticles`.
    false_alarm : float, default 1e-3
        Probability of an alarm per step over all sensors.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = CentralFilter(two_tanks(), false_alarm=1e-6)
    >>> recording = simulate(detector.plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t == 150)[:, None] * [0.5, 0.0, 0.0, 0.0]  # a single wrong reading
    >>> decisions = run(detector, detector.init(), recording.t, y, recording.u)[1]
    >>> recording.t[decisions.isolated[:, 0]]
    array([150.])
    """

    estimator: Estimator = field(default_factory=Extended)
    false_alarm: float = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        require_filter(self.estimator)
        probability("false_alarm", self.false_alarm)

    @property
    def filter_model(self) -> Plant:
        return self.plant

    @property
    def most_faults(self) -> int:
        """One sensor: that with the largest innovation."""
        return 1

    def _start(self, batch: tuple[int, ...], seed: int) -> Core:
        return self.estimator.start(self.plant, batch, step_stream(seed, 0))

    def _judge(self, memory: Core, now: TimeStep, y: Array, u: Array) -> tuple[Core, Decision]:
        plant, est = self.plant, self.estimator
        prior = est.predict(plant, memory, now.t_start, u, now.dt, drawn_by(est, now.seed, now.k))
        joint = est.joint(plant, prior, now.t, u)
        y = plant.near(y, joint.y)
        found = statistics(joint, y, np.isfinite(y))
        x, p = posterior(joint, found)
        after = est.assimilate(plant, prior, Reading(now.t, y, u), x, p, drawn_by(est, now.seed, now.k + 2**32))
        expected = plant.output(now.t, x, u)
        residual = y - joint.y
        alpha = -ndtri(self.false_alarm / y.shape[-1] / 2) * self.threshold_scale
        threshold = np.sqrt(np.diagonal(joint.S, axis1=-2, axis2=-1)) * alpha
        ratio = np.where(np.isfinite(residual), np.abs(residual) / threshold, 0.0)
        isolated = (np.arange(y.shape[-1]) == np.argmax(ratio, axis=-1)[..., None]) & (ratio > 1)
        decision = Decision(
            estimate=x,
            reconstruction=np.where(np.isfinite(y), y, expected),
            residual=residual,
            threshold=threshold,
            isolated=isolated,
            fault_size=np.where(isolated, residual, np.nan),
            diverged=prior.lost | broken(x, p),
            guarded=prior.guarded,
            nis=normalised_innovation_squared(joint, found, y),
            covariance=p,
        )
        return after, decision
