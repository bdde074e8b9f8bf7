"""How long a bias stays undetected: biases are added to the healthy readings themselves, and the detector is run."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.plant.log import Log

Array = NDArray[Any]

SIZES = 3.0, 10.0  # sigma
AHEAD = 60  # samples in which it is to be detected
ONSETS = 3
RUNS = 240  # at most, of all sensors, onsets and signs together


class Delays(NamedTuple):
    """For each size (S) and sensor (N): the median delay (s), inf where less than half are detected, and the share detected.

    onsets: faults behind each. within: the time (s) in which they are to be detected.
    """

    sizes: tuple[float, ...]
    delay: Array
    detected_share: Array
    onsets: int
    within: float


def delays(detector: Detector, log: Log, warm_up: int, sizes: tuple[float, ...] = SIZES, sigma: Array | None = None) -> Delays:
    """Add a bias of each sensor to healthy readings of runs, y (K, B, N), and count until that sensor is isolated.

    Of a detector that does not isolate, until its own residual exceeds its threshold. The delay of a fault that is found in its
    first sample is 0. The detector starts `warm_up` samples before the onset; the onsets are spread over the log, with
    alternating signs. Readings that control the plant are taken as they were: the loop does not act on the bias.
    """
    plant = detector.plant
    sigma = plant.sensor_sigma if sigma is None else sigma
    steps, runs, count = log.y.shape
    ahead = min(AHEAD, max((steps - warm_up) // 2, 1))
    onsets = max(1, min(ONSETS, RUNS // (count * len(sizes))))
    first = np.linspace(warm_up, steps - ahead, onsets).astype(int)
    size = np.repeat(sizes, count)
    sensor = np.tile(np.arange(count), len(sizes))
    delay = np.full((onsets, size.size), np.inf)
    for j, onset in enumerate(first):
        part, run = slice(onset - warm_up, onset + ahead), j % runs
        y = np.repeat(log.y[part, run][:, None], size.size, axis=1)
        y[warm_up:, np.arange(size.size), sensor] += (-1) ** j * size * sigma[sensor]
        delay[j] = _first(detector, Log(log.t[part], y, log.u[part, run]), warm_up, sensor)
    shape = (onsets, len(sizes), count)
    with np.errstate(invalid="ignore"):
        middle = np.median(delay.reshape(shape), axis=0)
    found = np.mean(np.isfinite(delay).reshape(shape), axis=0)
    return Delays(tuple(sizes), np.where(found >= 0.5, middle, np.inf) * plant.dt, found, onsets, ahead * plant.dt)


def _first(detector: Detector, log: Log, warm_up: int, sensor: Array) -> Array:
    """The sample after warm_up at which each run (B,) names its sensor, inf where it does not."""
    state = detector.init(log.y.shape[1:-1], float(log.t[0]) - detector.plant.dt)
    found, each = np.full(sensor.size, np.inf), np.arange(sensor.size)
    for k, (t, y, u) in enumerate(zip(log.t.tolist(), log.y, log.u, strict=True)):
        state, decision = detector.step(state, t, y, u)
        if k >= warm_up:
            named = decision.isolated[each, sensor] | (decision.scores[each, sensor] > 1)
            found = np.where(named & np.isinf(found), float(k - warm_up), found)
            if np.all(np.isfinite(found)):
                break
    return found
