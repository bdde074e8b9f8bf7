"""One faulty run as every detector sees it: readings, residual over threshold, alarm and reconstruction over the same time.

The run of the first seed after settling: a window of healthy readings, one in which the middle sensor of the plant's list has a
bias, and one in which it is healthy again. Sensor and size are the same in every comparison, so none is chosen by its result.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.state import State
from fusion_sfdia.diagnosis.simulate import Recording
from fusion_sfdia.study.experiments.scenario import Arrays

Array = NDArray[Any]

SIGMAS = 10.0  # of the sensor's noise
PREFIX = "example_"
NOTHING, ALARM, RIGHT, WRONG = range(4)  # no alarm; an alarm; only the faulty sensor isolated; a healthy sensor isolated


def example(detector: Detector, recording: Recording, state: State, first: int, window: int) -> Arrays:
    """What a detector makes of the example; state: of one run (1, ...) before the sample `first`.

    Arrays (L,) of at most three windows, fewer where the recording ends: t in s from the first sample, the faulty sensor's
    reading y, its noise-free value signal, reconstruction, active (whether it is faulty), score (largest residual over
    threshold of all sensors; NaN where the estimator has diverged) and verdict (see VERDICTS); sensor: its index ().
    """
    plant, last = detector.plant, min(first + 3 * window, recording.t.size)
    sensor, t = len(plant.sensors) // 2, recording.t[first:last]
    active = np.arange(t.size) // window == 1
    y, u = recording.y[first:last, :1].copy(), recording.u_of_runs[first:last, :1]
    y[active, 0, sensor] += SIGMAS * plant.sensor_sigma[sensor]
    found: dict[str, list[Any]] = {"reconstruction": [], "score": [], "verdict": []}
    for k, at in enumerate(t):
        state, decision = detector.step(state, float(at), y[k], u[k])
        isolated = decision.isolated[0, : len(plant.sensors)]
        faulty = active[k] & (np.arange(isolated.size) == sensor)
        right = active[k] and bool(np.array_equal(isolated, faulty))
        wrong = bool(np.any(isolated & ~faulty))
        found["reconstruction"].append(decision.reconstruction[0, sensor])
        found["score"].append(decision.score[0])
        found["verdict"].append(RIGHT if right else WRONG if wrong else ALARM if decision.alarm[0] else NOTHING)
    kept = {"t": t - t[0], "y": y[:, 0, sensor], "signal": recording.signal[first:last, 0, sensor], "active": active}
    arrays = {k: np.asarray(v, np.float32) for k, v in (kept | found).items()}
    return {f"{PREFIX}{k}": v for k, v in (arrays | {"sensor": np.array(sensor)}).items()}
