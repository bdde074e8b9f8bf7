"""Detector: one bootstrap particle filter that tests each sensor with the same particles, weighted without its reading.

The noises of the readings are independent, so the weights without sensor i are the weights with all sensors divided by its
likelihood. This gives all leave-one-out filters at the cost of one, as `leave_one_out` does for Kalman filters, for any model
and distribution.

It is not an `Estimator` of the Kalman banks: they update by the covariance of state and readings and return mean and covariance
to the filter; particles transformed to these moments would be an ensemble Kalman filter. The number of particles needed grows
exponentially with the number of readings (Snyder et al. 2008): the filter is for plants with few sensors. With a thousand
particles on the 63 sensors of the gas pipeline, one particle has all the weight after the first reading. The estimation error
is then 2.4 times that of a Kalman filter, and 3.5 times its own standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.common.arguments import probability, whole
from fusion_sfdia.detectors.batch_detector import AccommodatingDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.health import broken
from fusion_sfdia.filters import particle
from fusion_sfdia.filters.estimators import require_none_considered, step_stream
from fusion_sfdia.filters.gaussian import add, whiten
from fusion_sfdia.filters.guarded_steps import guarded_points, readings_of_points
from fusion_sfdia.filters.particle import Particles
from fusion_sfdia.plant.redundancy import require_max_faults

Array = NDArray[Any]


class LeaveOneOutResiduals(NamedTuple):
    """Readings less their expectation from the other readings (..., N), NaN where not used; sigma (..., N) of this residual."""

    residual: Array
    sigma: Array


@dataclass(frozen=True)
class ParticleFilter(AccommodatingDetector):
    """Residual: a reading less its mean over the particles weighted by all other readings. Threshold: its standard deviation
    times a normal quantile at the probability `false_alarm` per step over all sensors (Bonferroni); only nominal where its
    distribution is far from normal. The sensor with the largest ratio is isolated and left out, until no ratio exceeds 1.

    Estimate and covariance are weighted moments.

    Parameters
    ----------
    size : int, default 1000
        Number of particles.
    false_alarm : float, default 1e-3
        Probability of an alarm per step over all sensors.
    max_faults : int, optional
        Sensors that may be isolated in a step (None: what the plant's redundancy allows).
    accommodate : bool, default True
        Weight the particles without the sensors isolated in this step.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import ParticleFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = ParticleFilter(two_tanks(), size=200)
    >>> recording = simulate(detector.plant, 30, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.5, 0.0, 0.0, 0.0]
    >>> run(detector, detector.init(), recording.t, y, recording.u)[1].isolated[-1].tolist()
    [True, False, False, False]
    """

    size: int = 1000
    false_alarm: float = 1e-3
    max_faults: int | None = None
    accommodate: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        require_none_considered(self.plant, "the weights of particles")
        if whole("size", self.size, least=1) < 2:
            raise ValueError(f"{self.size} particles; expected at least 2 for a covariance: give some hundreds")
        probability("false_alarm", self.false_alarm)
        require_max_faults(self.plant, self.max_faults)

    def _start(self, batch: tuple[int, ...], seed: int) -> Particles:
        return particle.start(self.plant.x0, self.plant.initial_cov, self.size, step_stream(seed, 0), batch)

    def _judge(self, memory: Particles, now: TimeStep, y: Array, u: Array) -> tuple[Particles, Decision]:
        plant = self.plant
        rng = step_stream(now.seed, now.k)
        _, ahead, moved, stuck, lost = guarded_points(plant, now.t_start, memory.members, u, now.dt)
        cloud = particle.predict(Particles(ahead, memory.log_weights), lambda s: s, plant.process_cov_over(now.dt), rng)
        predicted = readings_of_points(plant, now.t, cloud.members, u)
        middle, _ = particle.weighted_moments(predicted, cloud.weights)
        predicted, y = plant.near(predicted, middle[..., None, :]), plant.near(y, middle)
        tested, isolated, capped = self._eliminated(cloud, predicted, y)
        used = np.isfinite(y) & ~(isolated & self.accommodate)
        weighed = particle.weigh(cloud, predicted, np.where(used, y, np.nan), plant.sensor_cov)
        x, p = weighed.moments
        expected, _ = particle.weighted_moments(predicted, weighed.weights)
        after = particle.resample(weighed, rng)
        decision = Decision(
            estimate=x,
            reconstruction=np.where(used, y, expected),
            residual=tested.residual,
            threshold=self._alpha * tested.sigma,
            isolated=isolated,
            fault_size=np.where(isolated, tested.residual, np.nan),
            diverged=lost | broken(x, p),
            guarded=moved | stuck,
            nis=self._nis(cloud, predicted, np.where(used, y, np.nan)),
            covariance=p,
            capped=capped,
        )
        return after, decision

    @property
    def _alpha(self) -> float:
        return float(-ndtri(self.false_alarm / len(self.plant.sensors) / 2)) * self.threshold_scale

    def _eliminated(self, cloud: Particles, predicted: Array, y: Array) -> tuple[LeaveOneOutResiduals, Array, Array]:
        """The leave-one-out residuals of all readings, the isolated sensors (..., N), and whether another exceeds its threshold
        (...).
        """
        first = without_each(cloud, predicted, y, self.plant.sensor_cov)
        tested, isolated = first, np.zeros(y.shape, bool)
        while True:
            ratio = np.nan_to_num(np.abs(tested.residual) / (self._alpha * tested.sigma), nan=0.0)
            worst = np.arange(y.shape[-1]) == np.argmax(ratio, axis=-1)[..., None]
            above = worst & (ratio > 1)
            further = above & (np.sum(isolated, axis=-1, keepdims=True) < self.most_faults)
            if not np.any(further):
                return first, isolated, np.any(above, axis=-1)
            isolated = isolated | further
            tested = without_each(cloud, predicted, np.where(isolated, np.nan, y), self.plant.sensor_cov)

    def _nis(self, cloud: Particles, predicted: Array, y: Array) -> Array:
        """Return d' S^-1 d over the number of readings (...), S the weighted covariance of the predictions with the noise."""
        mean, spread = particle.weighted_moments(predicted, cloud.weights)
        used = np.isfinite(y)
        d = whiten((np.where(used, y, 0.0) - mean)[..., None, :], add(spread, self.plant.sensor_cov), used)[..., 0, :]
        count = np.sum(used, axis=-1)
        return np.where(count > 0, np.sum(d * d, axis=-1) / np.maximum(count, 1), np.nan)


def without_each(cloud: Particles, predicted: Array, y: Array, R: Array) -> LeaveOneOutResiduals:
    """Return the residual of each reading y (..., N), NaN where missing, against the cloud weighed by all others.

    predicted (..., M, N) are the members' readings, R (N,) the variances of their noises. With L_j the likelihood of y_j,

        w without i = w prod_(j != i) L_j / sum of the same,    residual_i = y_i - sum w h_i,    sigma_i^2 = var_w h_i + R_i
    """
    used = np.isfinite(y)
    inside = np.all(np.isfinite(predicted), axis=-1, keepdims=True)
    h = np.where(inside, predicted, 0.0)
    each = np.where(used[..., None, :] & inside, -0.5 * (np.where(used, y, 0.0)[..., None, :] - h) ** 2 / R, 0.0)
    prior = np.where(inside[..., 0], cloud.log_weights, -np.inf)
    without = (prior + np.sum(each, axis=-1))[..., None] - each
    w = np.exp(particle.normalise(np.swapaxes(without, -1, -2)))
    h = np.swapaxes(h, -1, -2)
    mean = np.sum(w * h, axis=-1)
    variance = np.sum(w * (h - mean[..., None]) ** 2, axis=-1)
    return LeaveOneOutResiduals(np.where(used, y - mean, np.nan), np.sqrt(variance + R))
