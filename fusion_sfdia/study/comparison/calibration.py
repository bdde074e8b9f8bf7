"""One rate of false alarms for all detectors: each is calibrated on healthy readings, once a process.

Two forms of a detector are run. The silent one has thresholds so high that nothing is ever isolated, replaced or latched: its
scores, times that scale, are those over which a threshold can be swept. The deployed one has its thresholds scaled to the
common rate, and isolates, replaces and latches.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.silent import require_scale, silent, silent_scores
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.diagnosis.simulate import Recording
from fusion_sfdia.study.comparison.recordings import healthy
from fusion_sfdia.study.comparison.subjects import ComparedDetector, ComparedPlant, plant_of

Array = NDArray[Any]

RESAMPLES = 200  # of runs: a standard error within 5 %
CALIBRATION_SEEDS = 910_000  # the first: apart from those of any run and from those that detectors are fitted on
CACHE = 64e6  # bytes of states beyond which a step of all runs at once takes longer than of parts of them


class Calibrated(NamedTuple):
    """A detector, the scale of its thresholds for the common rate, its healthy scores (K, R) at its own, and its claim.

    ends: the scale less and more by a standard error, which is that of a bootstrap over the R runs.
    """

    detector: Any  # a Detector that is a dataclass with threshold_scale
    scale: float
    ends: tuple[float, float]
    scores: Array
    claim: float  # NaN for none


@lru_cache(maxsize=64)  # the detectors of a plant, whose blocks of seeds follow each other
def calibrated(
    plant: ComparedPlant, by: ComparedDetector, settle: int, steps: int, runs: int, false_alarm: float
) -> Calibrated:
    """A detector and the scale at which it alarms at that rate, on healthy runs of `steps` samples after settling.

    The order statistic whose expected exceedance by a fresh sample is at most `false_alarm`. NotApplicableError for a detector
    that does not apply to the plant, that needs a package which is not installed, or whose scores cannot set a threshold;
    ValueError for one whose thresholds have no scale.
    """
    detector: Any = registry.detector(by.entry, plant_of(plant))
    require_scale(by.name, detector)
    recording = healthy(plant, settle + steps, tuple(range(CALIBRATION_SEEDS, CALIBRATION_SEEDS + runs)))
    scores = as_scores(scores_of(silent(detector), recording))[settle:]
    scale = float(order_statistic(scores.ravel(), false_alarm))
    if not 0 < scale < np.inf:
        raise NotApplicableError(
            f"its score on healthy readings is {scale:g} at most: no threshold brings it to a rate of false alarms"
        )
    return Calibrated(detector, scale, standard_ends(scores, scale, false_alarm), scores, float(detector.claimed_rate))


def scores_of(detector: Detector, recording: Recording) -> Array:
    """Scores (K, R) of a silent detector, of as many runs at once as have a state of `CACHE` bytes."""
    runs, state = recording.y.shape[1], detector.init((1,), float(recording.t[0]) - detector.plant.dt)
    together = max(1, int(CACHE // sum(a.nbytes for a in leaves(state))))
    parts = np.array_split(np.arange(runs), -(-runs // together))
    y, u = recording.y, recording.u_of_runs
    return np.concatenate([silent_scores(detector, recording.t, y[:, part], u[:, part])[1] for part in parts], axis=1)


def standard_ends(scores: Array, scale: float, false_alarm: float) -> tuple[float, float]:
    """The scale divided and multiplied by exp of the standard error of its logarithm, over resampled runs (scores (K, R))."""
    rng, runs = stream(0, "calibration runs"), scores.shape[1]
    drawn = [order_statistic(scores[:, rng.integers(runs, size=runs)].ravel(), false_alarm) for _ in range(RESAMPLES)]
    factor = float(np.exp(np.std(np.log(np.maximum(drawn, scale / 100)))))
    return scale / factor, scale * factor


def deployed(calibration: Calibrated, scale: float | None = None) -> Any:
    """The detector with thresholds at the common rate of false alarms, or at another scale."""
    by = calibration.scale if scale is None else scale
    return replace(calibration.detector, threshold_scale=by * calibration.detector.threshold_scale)


def as_scores(found: Array) -> Array:
    """Scores of a silent detector, 0 where they are not numbers because it diverged."""
    return np.nan_to_num(found, nan=0.0)
