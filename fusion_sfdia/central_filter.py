"""Detector: one Kalman filter on all sensors with a test of each innovation; the usual choice, and the banks' yardstick."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.detector import Decision, State, check_reading
from fusion_sfdia.estimators import Estimator, Extended, Reading, step_stream
from fusion_sfdia.health import broken, keep_broken_out, without_broken
from fusion_sfdia.leave_one_out import normalised_innovation_squared, posterior, statistics
from fusion_sfdia.plant import Plant

Array = NDArray[Any]


@dataclass(frozen=True)
class CentralFilter:
    """A single filter of any kind: residual y - E[y], threshold from its variance at a false-alarm budget per step over
    all sensors (Bonferroni); names the sensor with the largest ratio; nothing is accommodated.
    """

    plant: Plant
    estimator: Estimator = field(default_factory=Extended)
    false_alarm: float = 1e-3

    def __post_init__(self) -> None:
        if not 0 < self.false_alarm < 1:
            raise ValueError(f"false_alarm is {self.false_alarm}; a probability strictly between 0 and 1 is wanted")

    @property
    def hypotheses(self) -> tuple[str, ...]:
        return self.plant.sensor_names

    def init(self, batch: tuple[int, ...] = (), t: float = 0.0, seed: int = 0) -> State:
        """State at time t: seed, step count, time, diverged (*batch), and the filter's core."""
        core = self.estimator.start(self.plant, batch, step_stream(seed, 0))
        return np.array(seed, np.uint64), np.array(0), np.array(float(t)), np.zeros(batch, bool), *core

    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        """Filter the readings y (..., N) at t under the input u (..., m); ValueError for a wrong shape or time."""
        seed, k, last, diverged, *core = state
        check_reading(self.plant, y, u, diverged.shape)
        self.plant.check_dt(dt := t - float(last))
        k = k + 1
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            prior = self.estimator.predict(self.plant, tuple(core), float(last), u, dt, step_stream(seed, k))
            joint = self.estimator.joint(self.plant, prior, t, u)
            found = statistics(joint, y, np.isfinite(y))
            x, p = posterior(joint, found)
            reading = Reading(t, y, u)
            after = self.estimator.assimilate(self.plant, prior, reading, x, p, step_stream(seed, k + np.int64(2**32)))
            expected = self.plant.output(t, x, u)
        diverged = diverged | broken(x, p)
        after = keep_broken_out(diverged, after, self.init(diverged.shape, t, int(seed))[4:])
        residual = y - joint.y
        threshold = np.sqrt(np.diagonal(joint.S, axis1=-2, axis2=-1)) * -ndtri(self.false_alarm / y.shape[-1] / 2)
        ratio = np.where(np.isfinite(residual), np.abs(residual) / threshold, 0.0)
        isolated = (np.arange(y.shape[-1]) == np.argmax(ratio, axis=-1)[..., None]) & (ratio > 1)
        decision = Decision(
            estimate=x,
            measured=np.where(np.isfinite(y), y, expected),
            residual=residual,
            threshold=threshold,
            isolated=isolated,
            fault_size=np.where(isolated, residual, np.nan),
            diverged=diverged,
            guarded=prior.guarded,
            nis=normalised_innovation_squared(joint, found, y),
            covariance=p,
        )
        return (seed, k, np.array(t), diverged, *after), without_broken(decision, diverged)
