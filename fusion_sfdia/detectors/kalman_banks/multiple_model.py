"""Detector: a bank of models, "all healthy" and "sensor i faulty" for each i, with a Markov chain between them.

A faulty sensor's noise is `inflation` times as large. The first-order generalised pseudo-Bayes estimator (GPB1; Ackerson and Fu
1970; Bar-Shalom, Li and Kirubarajan 2001, sec. 11.6.4) starts the filters of all modes from one merged estimate. They
differ by rank one: with u, w, K_i of `leave_one_out`, v = (inflation^2 - 1) R_ii and g_i = v / (1 + v w_i), those of mode i are

    likelihood    log L_i - log L_0 = (g_i u_i^2 - log(1 + v w_i)) / 2
    estimate      x_i = x_0 - K_i g_i u_i,    P_i = P_0 + g_i K_i K_i'

and the merged ones, weighted by the modes' probabilities mu_i and with c_i = g_i u_i,

    x = x_0 - sum mu_i c_i K_i,    P = P_0 + sum mu_i (g_i + c_i^2) K_i K_i' - (sum mu_i c_i K_i)(...)'.

A fault begins in a step with the probability p, `fault_probability`, with equal probability on each sensor, and ends with the
probability 1 / `duration`. Sensor i is isolated where its mode is more probable than "all healthy", mu_i / mu_0 > 1. Only
single faults have modes: the combinations of several sensors would be too many. The residual of a sensor is sqrt(2 log(1 +
E_i)) standard deviations of its leave-one-out innovation, where E_i = (mu_i / mu_0) / (p / N) are the odds relative to those of
a beginning fault, and the threshold is E_i = N / p. This is not a false-alarm rate. A fault that may have begun at any time has
prior odds of about p duration / N, so Markov's inequality gives a bound of only about p duration per step, valid if modes were
not merged.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from fusion_sfdia.common.arguments import number, probability
from fusion_sfdia.detectors.batch_detector import BatchDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.health import broken
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, normalised_innovation_squared, posterior, statistics
from fusion_sfdia.filters.estimators import (
    UNUSED,
    Estimator,
    Extended,
    GaussianState,
    require_consistent,
    require_none_considered,
    step_stream,
)
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


class MultipleModelMemory(NamedTuple):
    """The merged estimate, and the logarithms of the modes' probabilities (..., N + 1), healthy first."""

    estimate: GaussianState
    log_probability: Array


@dataclass(frozen=True)
class MultipleModel(BatchDetector):
    """GPB1 over N + 1 modes on an extended filter (or an unscented one with redraw).

    Readings are weighted by the probability that their sensor is healthy, so the estimate depends on no threshold.

    Parameters
    ----------
    estimator : Estimator, default Extended()
        The kind of filter.
    inflation : float, default 10
        Noise of a faulty sensor over that of a healthy one.
    fault_probability : float, default 1e-3
        Probability that a fault begins in a step; see the module for false alarms.
    duration : float, default 100
        Mean duration of a fault in samples.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import MultipleModel
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = MultipleModel(two_tanks())
    >>> recording = simulate(detector.plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.2, 0.0, 0.0, 0.0]
    >>> run(detector, detector.init(), recording.t, y, recording.u)[1].isolated[-1].tolist()
    [True, False, False, False]
    """

    estimator: Estimator = field(default_factory=Extended)
    inflation: float = 10.0
    fault_probability: float = 1e-3
    duration: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_consistent(self.estimator)
        require_none_considered(self.plant, "a mixture of modes")
        probability("fault_probability", self.fault_probability)
        for what in ("inflation", "duration"):
            if not 1 < number(what, getattr(self, what)) < np.inf:
                raise ValueError(f"{what} is {getattr(self, what)}; expected a number above 1")

    @property
    def filter_model(self) -> Plant:
        return self.plant

    @property
    def most_faults(self) -> int:
        """One sensor: that of the most probable mode."""
        return 1

    def _start(self, batch: tuple[int, ...], seed: int) -> MultipleModelMemory:
        estimate = self.estimator.start(self.plant, batch, step_stream(seed, 0))
        count = len(self.plant.sensors)
        mode = np.log(np.append(1 - self.fault_probability, np.full(count, self.fault_probability / count)))
        return MultipleModelMemory(estimate, np.broadcast_to(mode, (*batch, count + 1)).copy())

    def _judge(self, memory: MultipleModelMemory, now: TimeStep, y: Array, u: Array) -> tuple[MultipleModelMemory, Decision]:
        plant, est = self.plant, self.estimator
        prior = est.predict(plant, memory.estimate, now.t_start, u, now.dt, UNUSED)
        joint = est.joint(plant, prior, now.t, u)
        y = plant.near(y, joint.y)
        found = statistics(joint, y, np.isfinite(y))
        mode, gain = self._weigh(self._predicted(memory.log_probability), found)
        mu = np.exp(mode[..., 1:])

        x, p = posterior(joint, found)
        columns = joint.C @ found.inverse  # K_i
        c = gain * found.whitened
        shift = (columns @ (mu * c)[..., None])[..., 0]
        x = x - shift
        spread = columns * np.sqrt(mu * (gain + c**2))[..., None, :]
        p = p + spread @ np.swapaxes(spread, -1, -2) - shift[..., :, None] * shift[..., None, :]

        share = self.fault_probability / y.shape[-1]
        evidence = np.logaddexp(0.0, mode[..., 1:] - mode[..., :1] - np.log(share))  # log(1 + E_i)
        deviation = np.sqrt(found.variance)
        limit = self.threshold_scale * np.sqrt(2 * np.log1p(1 / share))
        ratio = np.where(found.used, np.sqrt(2 * evidence) / limit, 0.0)
        isolated = (np.arange(y.shape[-1]) == np.argmax(ratio, axis=-1)[..., None]) & (ratio > 1)
        expected = plant.output(now.t, x, u)
        shown = np.where(np.signbit(found.innovation), -ratio, ratio) * limit * np.where(found.used, deviation, 1.0)
        decision = Decision(
            estimate=x,
            reconstruction=np.where(np.isfinite(y) & ~isolated, y, expected),
            residual=np.where(found.used, shown, np.nan),
            threshold=limit * deviation,
            isolated=isolated,
            fault_size=np.where(isolated, found.innovation, np.nan),
            diverged=prior.lost | broken(x, p),
            guarded=prior.guarded,
            nis=normalised_innovation_squared(joint, found, y),
            covariance=p,
        )
        return MultipleModelMemory(GaussianState(x, p), mode), decision

    def _predicted(self, mode: Array) -> Array:
        """Logarithms of the modes' probabilities (..., N + 1) a step later, before the readings."""
        begins, ends = self.fault_probability, 1 / self.duration
        count = mode.shape[-1] - 1
        healthy, faulty = mode[..., :1], mode[..., 1:]
        remains = np.logaddexp(healthy + np.log1p(-begins), logsumexp(faulty, axis=-1, keepdims=True) + np.log(ends))
        begun = np.logaddexp(healthy + np.log(begins / count), faulty + np.log1p(-ends))
        return np.concatenate([remains, begun], axis=-1)

    def _weigh(self, mode: Array, found: LeaveOneOut) -> tuple[Array, Array]:
        """Logarithms of the modes' probabilities after the readings (..., N + 1), and g (..., N)."""
        v = (self.inflation**2 - 1) * self.plant.sensor_cov
        gain = v / (1 + v * found.weight)
        ratio = (gain * found.whitened**2 - np.log1p(v * found.weight)) / 2
        weighed = np.concatenate([mode[..., :1], mode[..., 1:] + ratio], axis=-1)
        return weighed - logsumexp(weighed, axis=-1, keepdims=True), gain
