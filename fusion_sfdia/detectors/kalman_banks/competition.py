"""The decision between sensor and process, from the evidence of competing hypotheses.

The evidence of a hypothesis is twice the logarithm of its likelihood ratio to "nothing", averaged over its size (see
`likelihood_window.averaged`). A cause is accepted where its statistic exceeds its limit and its evidence that of the best
cause of the other kind by a margin. Where no cause is accepted, those within the margin of the best are suspects.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.kalman_banks import window_kernels
from fusion_sfdia.detectors.kalman_banks.bank_kernels import contiguous, of_runs
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, eliminate, one_hot, value_at
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Best, averaged

Array = NDArray[Any]

AS_BIAS = 2 / 3  # a bias c looks like a ramp that ends at c (sum k / sum k^2) times its length, 3 c / 2
ABSORBED = 2.0  # evidence by which an earlier onset is preferred to the present sample
LEAST_WEIGHT = 0.1  # of an alternative to an accepted process hypothesis
PRIOR = 1e-3  # probability of each hypothesis before any reading
LOG_PRIOR = float(np.log(PRIOR))


class ChiSquareLimits(NamedTuple):
    """Chi-square limits of one sample, of the windows for sensors and for the process; margins of evidence of both kinds.

    smallest (N + P,): sizes below which the windows accept nothing.
    """

    one: float
    window: float
    process: float
    sensor_margin: Array
    process_margin: float
    smallest: Array


class Evidence(NamedTuple):
    """The best explanation by each sensor (..., N) and by each process hypothesis (..., P).

    level (..., N + P): sizes, of a ramp or drift that of the bias or jump nearest to it. slow_sensor (..., N), slow_process
    (..., p): whether it is a ramp or drift. statistic_s, size_s, information_s (..., N), of the windows; statistic_p, size_p,
    information_p (..., P). sensor, one_sample (..., N): evidence of the windows and of the present sample; process (..., P).
    """

    level: Array
    slow_sensor: Array
    statistic_s: Array
    size_s: Array
    information_s: Array
    sensor: Array
    one_sample: Array
    slow_process: Array
    statistic_p: Array
    size_p: Array
    information_p: Array
    process: Array

    @property
    def best_process(self) -> Array:
        """Evidence of the best process hypothesis (...); -inf without any."""
        return np.asarray(np.max(self.process, axis=-1, initial=-np.inf))

    @property
    def of_sensors(self) -> Array:
        """Evidence of each sensor by the windows or the present sample (..., N)."""
        return np.maximum(self.sensor, self.one_sample)

    @property
    def probability(self) -> Array:
        """Probability of each hypothesis (..., N + P), if at most one is true."""
        half = np.concatenate([self.of_sensors, self.process], axis=-1) / 2 + LOG_PRIOR
        top = np.maximum(half.max(axis=-1, keepdims=True), 0.0)
        weight = np.exp(half - top)
        return np.asarray(weight / (weight.sum(axis=-1, keepdims=True) + np.exp(-top)))


def one_sample_evidence(found: LeaveOneOut, size: Array) -> Array:
    """Evidence of a bias of the present sample alone (..., N), of a size N(0, size^2), size (N,); -inf where not used."""
    return np.where(found.used, averaged(found.chi_square, found.weight * size**2), -np.inf)


def gathered(recent: Best, slow: Best, age: Array, one_sample: Array, handicap: Array) -> Evidence:
    """The evidence of all hypotheses from the two windows, less a handicap of those of the process (P,).

    age (..., L): of the onsets of the slow window.
    """
    count = one_sample.shape[-1]
    r, s = (tuple(map(contiguous, best)) for best in (recent, slow))
    found, far, level = window_kernels.merged(r[:4], s[:4], s[4], contiguous(age), of_runs(handicap, 1), AS_BIAS)
    statistic, size, information, evidence = found
    return Evidence(
        level,
        far[..., :count], statistic[..., :count], size[..., :count], information[..., :count], evidence[..., :count],
        one_sample,
        far[..., count:], statistic[..., count:], size[..., count:], information[..., count:], evidence[..., count:],
    )  # fmt: skip


class Present(NamedTuple):
    """Process hypotheses that begin now: M (..., N, P); sizes (N + P,) of sensors and process; handicap (..., P)."""

    M: Array
    sizes: Array
    handicap: Array


def eliminated(
    found: LeaveOneOut, evidence: Evidence, present: Present, limits: ChiSquareLimits, room: Array
) -> tuple[Array, Array]:
    """Eliminate the worst sensor of the present sample while it explains the sample better than the process does.

    The first sensor competes by all its evidence, also with process hypotheses that begin now, each further one by the readings
    that are left, with these alone. room (...): sensors that may still be left out. Return the eliminated sensors (..., N), and
    whether another is above the limit (...).
    """
    count = found.used.shape[-1]
    isolated = np.zeros(found.used.shape, bool)
    of_sensors = evidence.of_sensors
    of_process = np.maximum(evidence.best_process, _beginning_now(found, present))
    while True:
        chi_square = found.chi_square
        worst = np.argmax(chi_square, axis=-1)
        above = np.max(chi_square, axis=-1) > limits.one
        lead = value_at(of_sensors, worst) - of_process
        free = np.sum(isolated, axis=-1) < room
        where = above & free & (lead > limits.sensor_margin)
        if not np.any(where):
            return isolated, above & ~free
        isolated = isolated | (where[..., None] & one_hot(worst, count))
        found = eliminate(found, worst, where)
        of_sensors = np.where(where[..., None], one_sample_evidence(found, present.sizes[:count]), of_sensors)
        of_process = np.where(where, _beginning_now(found, present), of_process)


def _beginning_now(found: LeaveOneOut, present: Present) -> Array:
    """Evidence of the best process hypothesis that begins with the present sample (...)."""
    M, size = present.M, present.sizes[found.used.shape[-1] :]
    a = (np.swapaxes(M, -1, -2) @ found.whitened[..., None])[..., 0]
    b = np.einsum("...ij,...ij->...j", M, found.inverse @ M)
    known = b * size**2
    evidence = a**2 * size**2 / (1 + known) - np.log1p(known) - present.handicap
    return np.asarray(np.max(evidence, axis=-1, initial=-np.inf))


def absorbed_before(evidence: Evidence, isolated: Array, sensor: Array) -> Array:
    """Whether the isolated sensor (...) has more evidence by the windows than by the sample: the filter has absorbed it."""
    if not isolated.any():
        return np.zeros(sensor.shape, bool)
    with np.errstate(invalid="ignore"):  # -inf - -inf of a sensor that is not used
        more = value_at(evidence.sensor - evidence.one_sample, sensor) > ABSORBED
    return np.asarray(value_at(isolated, sensor) & more)


def led_by(led: Array, leads: Array, fault: Array) -> Array:
    """Samples in a row in which a sensor leads (..., N), with the sign of its fault, so far `led`."""
    if not leads.any():
        return np.zeros(led.shape)
    sign = np.where(fault < 0, -1.0, 1.0)
    return np.where(leads, np.where(led * sign > 0, led + sign, sign), 0.0)


class Accepted(NamedTuple):
    """What the windows accept: the sensor and the process hypothesis with the most evidence (...), and whether they are."""

    sensor: Array
    is_sensor: Array
    process: Array
    is_process: Array


def accepted(evidence: Evidence, limits: ChiSquareLimits, where: Array) -> Accepted:
    """Accept a sensor or a process hypothesis by the windows, in the runs `where` (...) holds."""
    sensor, process = evidence.sensor.argmax(axis=-1), evidence.process.argmax(axis=-1)
    if not ((evidence.statistic_s > limits.window).any() or (evidence.statistic_p > limits.process).any()):
        none = np.zeros(sensor.shape, bool)
        return Accepted(sensor, none, process, none)
    large, count = np.abs(evidence.level) >= limits.smallest, evidence.sensor.shape[-1]
    of_sensor, statistic = (value_at(v, sensor) for v in (evidence.sensor, evidence.statistic_s))
    is_sensor = where & (statistic > limits.window) & (of_sensor - evidence.best_process > limits.sensor_margin)
    is_sensor = is_sensor & value_at(large, sensor)
    of_process, statistic = (value_at(v, process) for v in (evidence.process, evidence.statistic_p))
    lead = of_process - np.max(evidence.of_sensors, axis=-1)
    is_process = where & (statistic > limits.process) & (lead > limits.process_margin)
    is_process = is_process & value_at(large, count + process)
    return Accepted(sensor, is_sensor, process, is_process)


def suspects(evidence: Evidence, undecided: Array, margin: float) -> Array:
    """The hypotheses (..., N + P) within the margin of the best, where an alarm is undecided (...)."""
    if not undecided.any():
        return np.zeros(evidence.level.shape, bool)
    every = np.concatenate([evidence.of_sensors, evidence.process], axis=-1)
    top = np.max(every, axis=-1, keepdims=True)
    return np.asarray(undecided[..., None] & (every > top - margin))


def alternatives(evidence: Evidence, by_windows: Accepted, margin: float) -> Array:
    """Weights (..., P) of the process hypotheses within a margin of the one that is accepted; 0 for others and where none is.

    The weight is the ratio of the probabilities, at least LEAST_WEIGHT.
    """
    behind = evidence.best_process[..., None] - evidence.process
    rival = by_windows.is_process[..., None] & (behind < margin) & (behind > 0)
    return np.where(rival, np.maximum(np.exp(-np.where(rival, behind, 0.0) / 2), LEAST_WEIGHT), 0.0)
